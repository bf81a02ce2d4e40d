# SPDX-License-Identifier: GPL-3.0-or-later
"""From clicks on a few photos to a mask of every photo (section 3.1.2 of the paper).

Clicks -> belief about all regions and points -> root masks -> vote of the points (eq. 3) -> child masks from the
points -> a second vote by all photos, which corrects or flags the masks that contradict it.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.config import Config
from mgf_engine.masks.belief import Belief, SceneGraph
from mgf_engine.masks.extent import Extent
from mgf_engine.masks.model import UNKNOWN, MaskSet, building
from mgf_engine.masks.points import track_owner, vote
from mgf_engine.masks.prompts import Clicks, Prompts
from mgf_engine.masks.regions import Regions, cut_regions
from mgf_engine.masks.segmenters.base import Hints, Segment, Segmenter
from mgf_engine.masks.shape import Shape, measure_shape
from mgf_engine.messages import Reporter
from mgf_engine.scene.model import Scene
from mgf_engine.system import cores

#: Agreement below which a photo is prompted again, and below which it is flagged and not trained on.
RETRY_BELOW = 0.9
FLAG_BELOW = 0.75
#: A mask below this share of its photo shows too little of the building to train on.
MIN_BUILDING = 0.005


@dataclass(frozen=True)
class Propagation:
    """Masks of all photos, and per photo why it is flagged (empty: it is fine)."""

    masks: MaskSet
    reasons: list[str]


def propagate(
    scene: Scene, prompts: Prompts, segmenter: Segmenter, config: Config, reporter: Reporter
) -> Propagation:
    """Masks of every photo from clicks on some.

    Args:
        prompts: clicks by view index; at least one on the building.
        segmenter: draws each mask.
    """
    threads = config.threads or cores()
    work = _Work(scene, prompts, segmenter, config, reporter, threads)
    belief = work.believe()
    return work.masks_from(belief)


class _Work:
    """One run: the scene, its regions and shape, and the segmenter."""

    def __init__(
        self, scene: Scene, prompts: Prompts, segmenter: Segmenter, config: Config, reporter: Reporter, threads: int
    ) -> None:
        self.scene, self.prompts, self.segmenter = scene, prompts, segmenter
        self.config, self.reporter, self.threads = config, reporter, threads
        self.owner = track_owner(scene)
        self.regions: list[Regions] = []
        self.shape: Shape
        self.graph: SceneGraph

    def believe(self) -> Belief:
        """Regions of all photos and the belief on them."""
        views = range(len(self.scene.views))
        for index, regions in self._parallel(lambda i: cut_regions(self.scene.photo(i)), views):
            self.regions.append(regions)
            self.reporter.progress(0.4 * (index + 1) / len(views))
        self.shape = measure_shape(self.scene)
        self.graph = SceneGraph(self.scene, self.regions, self.shape)
        belief = self.graph.solve(self.prompts, self.config.seed)
        self.reporter.progress(0.5)
        return belief

    def masks_from(self, belief: Belief) -> Propagation:
        """Roots, vote, children, second vote."""
        views = range(len(self.scene.views))
        accepted = belief.points > 0.5
        roots = [i for i in views if i in self.prompts]
        labels: list[NDArray[np.uint8]] = [np.zeros((v.height, v.width), np.uint8) for v in self.scene.views]
        segments: dict[int, Segment] = {}
        for index, segment in self._parallel(lambda i: self._segment(i, belief, accepted), roots):
            segments[index] = segment
            labels[index] = segment.mask.astype(np.uint8)
            self.reporter.progress(0.5 + 0.4 * len(segments) / len(views))
        accepted = self._accepted(labels, roots, belief)
        children = [i for i in views if i not in self.prompts]
        for index, segment in self._parallel(lambda i: self._segment(i, belief, accepted), children):
            segments[index] = segment
            labels[index] = segment.mask.astype(np.uint8)
            self.reporter.progress(0.5 + 0.4 * len(segments) / len(views))
        return self._finish(labels, segments)

    def _accepted(self, labels: list[NDArray[np.uint8]], voters: list[int], belief: Belief) -> NDArray[np.bool_]:
        """Points accepted by the voters; the belief speaks for points in no voter's frame."""
        rows = np.arange(len(self.scene.points))
        kept = vote(self.scene.points, self.scene, labels, voters, self.config, rows)
        seen = np.zeros(len(rows), bool)
        seen[self.owner[np.isin(self.scene.track_view, voters)]] = True
        return np.where(seen, kept, belief.points > 0.5)

    def _segment(self, index: int, belief: Belief, accepted: NDArray[np.bool_]) -> Segment:
        photo = self.scene.photo(index)
        return self.segmenter.segment(index, photo, self._hints(index, belief, accepted))

    def _hints(self, index: int, belief: Belief, accepted: NDArray[np.bool_]) -> Hints:
        view, regions = self.scene.views[index], self.regions[index]
        clicks = self.prompts.get(index, Clicks())
        here = np.flatnonzero(self.scene.track_view == index)
        good = accepted[self.owner[here]]
        uv = self.scene.track_uv[here]
        small = belief.regions[index][regions.labels]
        return Hints(
            clicks.positive,
            clicks.negative,
            uv[good],
            uv[~good],
            _box(uv[good]),
            cv2.resize(small, (view.width, view.height), interpolation=cv2.INTER_LINEAR),
        )

    def _finish(self, labels: list[NDArray[np.uint8]], segments: dict[int, Segment]) -> Propagation:
        views = range(len(self.scene.views))
        scores = np.array([segments[i].score for i in views], np.float32)
        reasons = [_reason(labels[i], float(scores[i])) for i in views]
        used = np.array([not r for r in reasons], bool)
        voters = [i for i in views if used[i]] or list(views)
        rows = np.arange(len(self.scene.points))
        point_mask = vote(self.scene.points, self.scene, labels, voters, self.config, rows)
        extent = Extent(self.scene, self.shape, point_mask, self.graph.ground, self.graph.sight)
        for index, view in enumerate(self.scene.views):
            core = cv2.resize(extent.place(index).core.astype(np.uint8), (view.width, view.height))
            labels[index][(core > 0) & (labels[index] == 0)] = UNKNOWN
            self.reporter.progress(0.9 + 0.1 * (index + 1) / len(views))
        return Propagation(MaskSet(tuple(labels), used, scores, point_mask), reasons)

    def _parallel(self, task, indices) -> Iterator[tuple[int, object]]:  # type: ignore[no-untyped-def]
        """(index, result) in order, on a few threads; OpenCV and NumPy release the interpreter."""
        with ThreadPoolExecutor(max(1, self.threads)) as pool:
            yield from zip(indices, pool.map(task, indices), strict=True)


def _box(points: NDArray[np.floating]) -> tuple[float, float, float, float] | None:
    if len(points) < 3:
        return None
    low, high = np.percentile(points, [2, 98], axis=0)
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _reason(labels: NDArray[np.uint8], score: float) -> str:
    share = float(building(labels).mean())
    if share < MIN_BUILDING:
        return "hardly any building in this photo"
    if score < FLAG_BELOW:
        return f"mask and points agree only to {score:.0%}"
    return ""
