# SPDX-License-Identifier: GPL-3.0-or-later
"""Propagate clicks on a few photos to a mask of every photo (section 3.1.2 of the paper).

Clicks -> probability of all regions and points -> root masks -> vote of the points (eq. 3) -> child masks from the
points -> a second vote by all photos, which corrects or flags the masks that contradict it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.geometry.building_extent import ExtentOptions
from mgf_engine.masks.geometry.densify_points import DensifyOptions, densify_points
from mgf_engine.masks.geometry.point_features import PointFeatureOptions, measure_point_features
from mgf_engine.masks.map_photos import map_photos
from mgf_engine.masks.points import (
    VoteOptions,
    Votes,
    choose_voters,
    observed_pixels,
    observed_votes,
    track_votes,
    vote,
)
from mgf_engine.masks.prompts import Clicks, Prompts
from mgf_engine.masks.propagation.appearance import vegetation_probability
from mgf_engine.masks.propagation.correct_masks import MaskCorrection
from mgf_engine.masks.propagation.draw_mask import draw_mask, make_hints
from mgf_engine.masks.propagation.label_graph import LabelGraph
from mgf_engine.masks.propagation.prompt_agreement import PromptAgreementOptions, drop_confirmed
from mgf_engine.masks.propagation.prompt_cross_validation import PromptCrossValidation, PromptOutlierOptions
from mgf_engine.masks.propagation.prompt_evidence import PromptEvidenceOptions
from mgf_engine.masks.propagation.prompt_messages import PromptMessages
from mgf_engine.masks.propagation.prompt_outliers import OutlierPrompt, ignored_outliers, without_outliers
from mgf_engine.masks.propagation.propagation_options import PropagationOptions
from mgf_engine.masks.propagation.random_walker import LabelPropagation
from mgf_engine.masks.propagation.random_walker_options import RandomWalkerOptions
from mgf_engine.masks.propagation.sky_regions import SkyOptions
from mgf_engine.masks.propagation.superpixels import SuperpixelOptions, Superpixels, cut_regions
from mgf_engine.masks.propagation.transient_prompts import TransientPromptOptions
from mgf_engine.masks.segmenters.base import Hints, Segment, Segmenter, agreement
from mgf_engine.masks.validation.cross_view_consistency import CrossViewOptions
from mgf_engine.masks.validation.mask_flags import FlagOptions, flag_by_masks, flag_reason, measure_consistency
from mgf_engine.messages import Reporter
from mgf_engine.model.masks import IGNORE, MaskSet, building
from mgf_engine.model.pixels import pixel_at
from mgf_engine.model.scene import Scene
from mgf_engine.options.config import Config
from mgf_engine.scene.gravity import GravityOptions, find_up
from mgf_engine.system.machine import cores

T = TypeVar("T")


@dataclass(frozen=True)
class Propagation:
    """Masks of all photos.

    Attributes:
        masks: the label maps.
        reasons: why each photo is flagged, empty where it is not.
        warnings: sentences that the user should read.
        consistency: share of the points seen in three photos or more on which all votes agree.
    """

    masks: MaskSet
    reasons: list[str]
    warnings: list[str]
    consistency: float


def propagate(scene: Scene, prompts: Prompts, segmenter: Segmenter, config: Config, reporter: Reporter) -> Propagation:
    """Make masks of all photos from clicks on some of them.

    Args:
        scene: photos, cameras and sparse points.
        prompts: clicks by view index; at least one on the building.
        segmenter: draws each mask.
        config: of the job.
        reporter: for progress, warnings and the request to cancel.
    """
    return _Propagator(scene, prompts, segmenter, config, reporter).run()


class _Propagator:
    """State of one run: the scene, its regions, their probabilities, and the masks."""

    def __init__(
        self, scene: Scene, prompts: Prompts, segmenter: Segmenter, config: Config, reporter: Reporter
    ) -> None:
        self.options, self.vote_options = config.algorithm(PropagationOptions), config.algorithm(VoteOptions)
        self.scene, self.prompts, self.segmenter = scene, prompts, segmenter
        self.config, self.reporter = config, reporter
        self.threads = config.threads or cores()
        self.owner = scene.track_point
        self.views = range(len(scene.views))
        self.regions: list[Superpixels] = []
        self.labels: list[NDArray[np.uint8]] = [np.zeros((v.height, v.width), np.uint8) for v in scene.views]
        self.scores = np.zeros(len(scene.views), np.float32)

    def run(self) -> Propagation:
        """Make the masks: regions, probabilities, root masks, vote, child masks, second vote, corrections."""
        superpixels = self.config.algorithm(SuperpixelOptions)
        for index, regions in self._parallel(lambda i: cut_regions(self.scene.photo(i), superpixels), self.views):
            self.regions.append(regions)
            self.reporter.progress(0.25 * (index + 1) / len(self.views))
        self.full = densify_points(
            self.scene,
            {i: self._positive(i) for i in self.prompts},
            self._leafy,
            self.threads,
            self.reporter.check,
            self.config.algorithm(DensifyOptions),
        )
        self.reporter.progress(0.4)
        self.up = find_up(self.scene, self.threads, self.config.algorithm(GravityOptions))
        self.reporter.check()
        features = self.config.algorithm(PointFeatureOptions)
        self.point_features = measure_point_features(self.scene, self.up.vector, features)
        self.reporter.check()
        self.graph = LabelGraph(
            self.scene, self.regions, self.point_features, self.threads, self.full,
            self.config.algorithm(RandomWalkerOptions), self.config.algorithm(SkyOptions),
        )  # fmt: skip
        self.reporter.check()
        self.walker = LabelPropagation(self.graph, self.config.algorithm(ExtentOptions))
        outliers = self._drop_outlier_prompts()
        self.reporter.check()
        self.probability = self.walker.solve(self.prompts, self.config.seed)
        self.reporter.progress(0.5)
        roots = [i for i in self.views if i in self.prompts]
        on_building = self.probability.points > 0.5
        self._draw(roots, on_building, 0.5)
        accepted = self._vote(roots)
        children = [i for i in self.views if i not in self.prompts]
        self._draw(children, accepted, 0.5 + 0.35 * len(roots) / len(self.views))
        disagreement = self._second_vote()
        return self._finish(disagreement, outliers)

    def _drop_outlier_prompts(self) -> list[OutlierPrompt]:
        """Leave out clicks that the other photos contradict; return all outliers, also those that are used."""
        suspects = PromptCrossValidation(
            self.walker, self.prompts, self.config.seed,
            self.config.algorithm(PromptOutlierOptions), self.config.algorithm(PromptEvidenceOptions),
        ).run(self.reporter.check)  # fmt: skip
        agreement = self.config.algorithm(PromptAgreementOptions)
        outliers = drop_confirmed(suspects.outliers, self.scene, self.prompts, agreement)
        self.doubted = suspects.kept + [click for click in suspects.outliers if click not in outliers]
        kept = without_outliers(self.prompts, ignored_outliers(outliers, self.prompts))
        self.original = self.prompts
        if any(len(c.positive) for c in kept.values()):
            self.prompts = kept
        return outliers

    def _draw(self, indices: list[int], accepted: NDArray[np.bool_], done: float) -> None:
        """Draw the masks of some views, prompted again where they agree badly."""
        for index, segment in self._parallel(lambda i: self._segment(i, accepted), indices):
            self.labels[index] = segment.mask.astype(np.uint8)
            self.scores[index] = segment.score
            done += 0.35 / len(self.views)
            self.reporter.progress(done)

    def _segment(self, index: int, accepted: NDArray[np.bool_]) -> Segment:
        hints = self._hints(index, accepted[self.owner[self.scene.observations(index)]])
        return draw_mask(self.segmenter, self.scene.photo(index), hints, self.options)

    def _hints(self, index: int, accepted: NDArray[np.bool_]) -> Hints:
        """Return what the segmenter is told of a photo; ``accepted``: of its observations, bool [O]."""
        clicks = self.prompts.get(index, Clicks())
        return make_hints(self.scene, index, clicks, self.regions[index], self.probability, accepted)

    def _vote(self, voters: list[int]) -> NDArray[np.bool_]:
        """Return the points that the voters' masks accept; probability decides where none of them observed one."""
        kept = self._accepted(self.scene, voters)
        seen = np.zeros(len(kept), bool)
        seen[self.owner[np.isin(self.scene.track_view, voters)]] = True
        return np.where(seen, kept, self.probability.points > 0.5)

    def _accepted(self, scene: Scene, voters: list[int]) -> NDArray[np.bool_]:
        """Return the points of the scene, or of the full one, that the voters' masks accept."""
        rows = np.arange(len(scene.points))
        return vote(scene.points, scene, self.labels, voters, self.vote_options, rows, self.threads)

    def _second_vote(self) -> NDArray[np.float64]:
        """Compare each mask with the votes of all others on its points; draw it again if they differ.

        Returns:
            [V], share of each photo's points on which the others still disagree.
        """
        result = np.zeros(len(self.views))
        votes = track_votes(self.scene, self.labels, list(self.views), self.vote_options.dilation)
        for index, disagreement in self._parallel(lambda i: self._redraw_contradicted(i, votes), self.views):
            result[index] = disagreement
            self.reporter.check()
        return result

    def _redraw_contradicted(self, index: int, votes: Votes) -> float:
        """Draw a mask again where all others contradict it; returns the share that they still contradict."""
        result, accepted = self._disagreement(index, votes)
        if result <= self.options.disagree_above:
            return result
        hints = self._hints(index, accepted)
        before = agreement(building(self.labels[index]), hints)
        again = self.segmenter.segment(self.scene.photo(index), hints, attempt=1)
        if again.score <= max(before, self.scores[index] - self.options.retry_gain):
            return result
        self.labels[index] = again.mask.astype(np.uint8)
        self.scores[index] = again.score
        return self._disagreement(index, votes)[0]

    def _disagreement(self, index: int, votes: Votes) -> tuple[float, NDArray[np.bool_]]:
        """Return the share of a photo's observations that two other masks or more contradict, and those that they
        accept, bool [O]."""
        points, place, own = observed_votes(self.scene, self.labels, index, self.vote_options.dilation)
        inside, outside = votes.inside[points] - own.inside, votes.outside[points] - own.outside
        accepted = np.where(inside + outside > 0, inside > outside, self.probability.points[points] > 0.5)[place]
        sure = (np.abs(inside - outside) >= 2)[place]
        y, x = pixel_at(self.labels[index].shape, self.scene.track_uv[self.scene.observations(index)])
        differ = ((own.inside > 0)[place] != accepted) & sure & (self.labels[index][y, x] != IGNORE)
        return float(differ.sum() / max(1, sure.sum())), accepted

    def _finish(self, disagreement: NDArray[np.float64], outliers: list[OutlierPrompt]) -> Propagation:
        flags = self.config.algorithm(FlagOptions)
        reasons = [
            flag_reason(self.labels[i], float(self.scores[i]), float(disagreement[i]), flags) for i in self.views
        ]
        reasons = self._test_without_points(reasons)
        used = np.array([not r for r in reasons], bool)
        voters = [i for i in self.views if used[i]] or list(self.views)
        accepted = self._accepted(self.full, voters)
        point_mask = accepted[: len(self.scene.points)]
        if self.options.finish:
            explained = self._correct(accepted, voters)
            if explained is not None:
                point_mask = self._accepted(self.scene, voters)
                outliers = [
                    click for click in outliers if not (click.positive and (click.view, click.row) in explained)
                ]
        clicks = tuple(self._positive(i).astype(np.float32) for i in self.views)
        if self.vote_options.voters != "all":
            clicked = [i for i in self.views if len(clicks[i])]
            point_mask = self._accepted(self.scene, choose_voters(self.scene, voters, clicked, self.vote_options))
        masks = MaskSet(tuple(self.labels), used, self.scores, point_mask, clicks, self.up)
        return Propagation(
            masks,
            reasons,
            self._prompt_messages(outliers),
            measure_consistency(self.scene, masks, self.vote_options.dilation),
        )

    def _correct(self, accepted: NDArray[np.bool_], voters: list[int]) -> set[tuple[int, int]] | None:
        """Correct the masks in place, see :class:`MaskCorrection`; ``accepted``: points of the full scene."""
        correction = MaskCorrection(
            self.graph, self.labels, self.prompts, self.original, self.probability.ground, self.config, self.reporter
        )
        extent = self.walker.geometry.extent(accepted, self.probability.ground, self.prompts)
        return correction.run(extent, accepted[: len(self.scene.points)], voters)

    def _prompt_messages(self, outliers: list[OutlierPrompt]) -> list[str]:
        transient = self.config.algorithm(TransientPromptOptions)
        messages = PromptMessages(self.graph, self.original, self.labels, transient)
        return messages.sentences(outliers, self.doubted, ignored=self.prompts is not self.original)

    def _test_without_points(self, reasons: list[str]) -> list[str]:
        """Replace flags that rest on too few points: test those masks by clicks and the other masks instead."""
        kept = self._accepted(self.scene, list(self.views))
        least = self.config.algorithm(CrossViewOptions).least_points
        tested = [len(observed_pixels(self.scene, i, kept)) >= least or i in self.prompts for i in self.views]
        masks = MaskSet(tuple(self.labels), np.array([not r for r in reasons]), self.scores, kept)
        return flag_by_masks(self.scene, masks, reasons, np.array(tested), self.config.algorithm(FlagOptions))

    def _positive(self, index: int) -> NDArray[np.float64]:
        return self.prompts.get(index, Clicks()).positive

    def _leafy(self, index: int) -> NDArray[np.bool_]:
        """Find the regions of a photo that look like leaves, on the reduced photo."""
        regions = self.regions[index]
        return np.asarray(vegetation_probability(regions.features)[regions.labels] > self.options.leafy, bool)

    def _parallel(self, task: Callable[[int], T], indices: Iterable[int]) -> Iterator[tuple[int, T]]:
        return map_photos(self.scene, task, indices, self.threads)
