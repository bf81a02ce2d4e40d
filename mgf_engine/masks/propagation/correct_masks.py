# SPDX-License-Identifier: GPL-3.0-or-later
"""Correct the drawn masks (beyond the paper): sky, ground, plants, homogeneous regions, thin structures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.geometry.building_extent import BuildingExtent
from mgf_engine.masks.geometry.ground_plane import GroundPlane
from mgf_engine.masks.image_ops import rgb_to_lab
from mgf_engine.masks.map_photos import map_photos
from mgf_engine.masks.points import observed_pixels
from mgf_engine.masks.prompts import Clicks, Prompts
from mgf_engine.masks.propagation.label_graph import LabelGraph
from mgf_engine.masks.propagation.propagation_options import PropagationOptions
from mgf_engine.masks.propagation.sky_regions import SkyOptions, draw_skyline
from mgf_engine.masks.refinement.far_background import FarBackgroundOptions, remove_far_background
from mgf_engine.masks.refinement.ground_homography import GroundFinder, GroundHomographyOptions
from mgf_engine.masks.refinement.homogeneous_regions import HomogeneousRegionOptions, find_missing_pixels
from mgf_engine.masks.refinement.ignored_surface import IgnoredSurfaceOptions, find_ignored_surface
from mgf_engine.masks.refinement.lab_photos import LabPhotos
from mgf_engine.masks.refinement.mirrored_ground import MirroredGroundOptions, MirrorTest
from mgf_engine.masks.refinement.mirrored_sky import MirroredSkyOptions, find_mirrored_sky
from mgf_engine.masks.refinement.sky_holes import SkyHoleOptions, find_sky_holes
from mgf_engine.masks.refinement.stray_pieces import find_stray_pieces
from mgf_engine.masks.refinement.thin_structures import (
    SceneContext,
    ThinStructureOptions,
    ThinStructures,
    find_thin_structures,
)
from mgf_engine.masks.refinement.vegetation import LeafOptions, find_foreground_leaves
from mgf_engine.messages import Reporter
from mgf_engine.model.masks import BACKGROUND, BUILDING, IGNORE, building
from mgf_engine.options.config import Config

T = TypeVar("T")


class _Pierced(NamedTuple):
    """Holes cut into a mask, as bits of its pixels, and its label map [H, W] before."""

    holes: NDArray[np.uint8]
    labels: NDArray[np.uint8]


class _Corrected(NamedTuple):
    """What the correction of one mask leaves for the next steps.

    Attributes:
        on_surface: observations of the view that lie on the building's surface or behind it, bool [N].
        pierced: the holes that were cut, and the mask before; None without holes.
    """

    on_surface: NDArray[np.bool_]
    pierced: _Pierced | None


class MaskCorrection:
    """Corrects the masks of one scene in place.

    Args:
        graph: regions and points of the scene, their sky and plants.
        labels: label maps of all photos, uint8 [H, W] each.
        prompts: clicks that count, by view index.
        all_prompts: all clicks; those on thin structures count as outliers, since regions are too coarse for them.
        plane: the ground; None where there is none.
        config: of the job.
        reporter: for progress and the request to cancel.
    """

    def __init__(
        self,
        graph: LabelGraph,
        labels: Sequence[NDArray[np.uint8]],
        prompts: Prompts,
        all_prompts: Prompts,
        plane: GroundPlane | None,
        config: Config,
        reporter: Reporter,
    ) -> None:
        self.graph, self.scene, self.labels = graph, graph.scene, labels
        self.prompts, self.all_prompts, self.plane = prompts, all_prompts, plane
        self.config, self.reporter = config, reporter

    def run(
        self, extent: BuildingExtent, accepted: NDArray[np.bool_], voters: Sequence[int]
    ) -> set[tuple[int, int]] | None:
        """Correct the masks in place: sky, ground, plants, homogeneous regions, thin structures.

        Args:
            extent: of the building in the photos.
            accepted: sparse points on the building, bool [P].
            voters: views whose masks are good enough to vote.

        Returns:
            clicks (view, row) on thin structures that were drawn; None where there are no such structures.
        """
        pierced, on_surface = {}, []
        for index, found in self._map(lambda i: self._correct_view(i, extent, accepted)):
            on_surface.append(found.on_surface)
            if found.pierced is not None:
                pierced[index] = found.pierced
            self.reporter.progress(0.9 + 0.1 * (index + 1) / len(self.scene.views))
        self._close_panes(pierced, extent, accepted, voters)
        self._fill_ignored(on_surface, voters)
        ground = None if self.plane is None else self._ground_finder(self.plane)
        opened = ground is not None and self._cut_ground(ground, voters)
        thin = self._add_thin_structures(ground, accepted)
        if opened or thin is not None:
            remove_far_background(
                self.scene, self.labels, self.graph.point_features.up,
                lambda i: observed_pixels(self.scene, i, accepted),
                self.graph.threads, self.config.algorithm(FarBackgroundOptions),
            )  # fmt: skip
        return None if thin is None else thin.explained

    def _ground_finder(self, plane: GroundPlane) -> GroundFinder:
        photos = LabPhotos(self.scene)
        mirrors = MirrorTest(photos, plane, self.labels, self.config.algorithm(MirroredGroundOptions))
        return GroundFinder(photos, plane, self.config.algorithm(GroundHomographyOptions), mirrors.confirmed)

    def _close_panes(
        self, pierced: dict[int, _Pierced], extent: BuildingExtent, accepted: NDArray[np.bool_], voters: Sequence[int]
    ) -> None:
        """Repeat the correction of masks whose sky holes are mirror images in panes, see :func:`find_mirrored_sky`."""
        points, options = self.scene.points[accepted], self.config.algorithm(MirroredSkyOptions)

        def mirrored(index: int) -> NDArray[np.bool_]:
            bits = np.unpackbits(pierced[index].holes, count=self.labels[index].size)
            holes = bits.reshape(self.labels[index].shape) > 0
            return find_mirrored_sky(self.scene, index, holes, self.labels, voters, points, options)

        found = dict(map_photos(self.scene, mirrored, pierced, self.graph.threads))
        panes = {index: panes for index, panes in found.items() if panes.any()}
        for index in panes:
            self.labels[index][:] = pierced[index].labels

        for _ in map_photos(
            self.scene, lambda i: self._correct_view(i, extent, accepted, panes[i]), panes, self.graph.threads
        ):
            self.reporter.check()

    def _fill_ignored(self, on_surface: Sequence[NDArray[np.bool_]], voters: Sequence[int]) -> None:
        """Take for building what all masks ignore at the same place of its surface."""
        least = self.config.algorithm(LeafOptions).leafy
        pieces = find_ignored_surface(
            self.graph.full, self.labels, on_surface, voters, self.all_prompts,
            lambda index: self._of_regions(index, self.graph.plants) > least,
            self.config.algorithm(IgnoredSurfaceOptions),
        )  # fmt: skip
        for labels, piece in zip(self.labels, pieces, strict=True):
            labels[piece] = BUILDING

    def _correct_view(
        self,
        index: int,
        extent: BuildingExtent,
        accepted: NDArray[np.bool_],
        panes: NDArray[np.bool_] | None = None,
    ) -> _Corrected:
        """Correct one mask in place: skyline, sky that shows through, stray pieces, plain regions, leaves.

        Args:
            index: of the view.
            extent: of the building in the photos.
            accepted: sparse points on the building, bool [P].
            panes: that mirror sky, bool [H, W], in which no holes are cut.
        """
        view, place = self.scene.views[index], extent.view_regions(index)
        parts = (place.core, place.core & ~place.ground_first, place.ground_first)
        core, seen, ground = (cv2.resize(part.astype(np.uint8), (view.width, view.height)) > 0 for part in parts)
        labels, sky = self.labels[index], self._sky(index)
        lab = rgb_to_lab(self.scene.photo(index))
        drawn = draw_skyline(lab, building(labels), sky, self.config.algorithm(SkyOptions))
        observed, options = self.scene.track_uv[self.scene.observations(index)], self.config.algorithm(SkyHoleOptions)
        through = find_sky_holes(lab, drawn | seen, sky, view, self.graph.point_features.up, observed, options)
        if panes is not None:
            through &= ~panes
        pierced = _Pierced(np.packbits(through), labels.copy()) if through.any() else None
        labels[:], sky = drawn & ~through, sky | through
        clicks = self.prompts.get(index, Clicks())
        known = np.concatenate([observed_pixels(self.scene, index, accepted), clicks.positive])
        cover = self.config.algorithm(PropagationOptions).stray_cover
        labels[find_stray_pieces(building(labels), core, known, cover)] = BACKGROUND
        regions = self.config.algorithm(HomogeneousRegionOptions)
        labels[find_missing_pixels(lab, labels, sky, clicks.negative, regions)] = BUILDING
        labels[seen & (labels == BACKGROUND) & ~sky] = IGNORE
        plants = self._of_regions(index, self.graph.plants)
        leaves = find_foreground_leaves(labels, plants, self.config.algorithm(LeafOptions))
        labels[leaves & ~sky & ~ground] = IGNORE
        return _Corrected(extent.within(index, place), pierced)

    def _add_thin_structures(self, ground: GroundFinder | None, accepted: NDArray[np.bool_]) -> ThinStructures | None:
        """Add clicked steelwork that the masks miss; outlier clicks count, too: superpixels are too coarse for it."""
        known = SceneContext(
            self.scene, accepted, self.graph.point_features.up, self.plane, self._sky,
            lambda index: self._of_regions(index, self.graph.plants),
        )  # fmt: skip
        options = self.config.algorithm(ThinStructureOptions)
        found = find_thin_structures(known, self.all_prompts, self.labels, options)
        if found is not None:
            for _ in self._map(lambda i: found.draw(i, self.scene.views[i], self.labels[i], ground)):
                self.reporter.check()
        return found

    def _cut_ground(self, ground: GroundFinder, voters: Sequence[int]) -> bool:
        """Remove the ground visible through an open building, and below what hangs over in a closed one.

        Pixels that may be ground become ignored.

        Returns:
            whether the building is an open one.
        """
        opened = ground.is_open_structure(voters, lambda i: building(self.labels[i]), self.graph.threads)
        find = ground.find_ground_pixels if opened else ground.find_wide_pieces
        for index, found in self._map(lambda i: find(i, self.labels[i] != BACKGROUND)):
            self.labels[index][found.certain] = BACKGROUND
            self.labels[index][found.possible] = IGNORE
        return opened

    def _sky(self, index: int) -> NDArray[np.bool_]:
        """Return the sky of a photo, bool [H, W]."""
        return self._of_regions(index, self.graph.sky > 0) > 0

    def _of_regions(self, index: int, values: NDArray[np.generic]) -> NDArray[np.float32]:
        """Spread values of the graph's nodes over a photo's pixels by their regions, float32 [H, W]."""
        view, graph = self.scene.views[index], self.graph
        small = values[graph.start[index] : graph.start[index + 1]].astype(np.float32)[graph.regions[index].labels]
        wide = cv2.resize(small, (view.width, view.height), interpolation=cv2.INTER_NEAREST)
        return np.asarray(wide, np.float32)

    def _map(self, task: Callable[[int], T]) -> Iterator[tuple[int, T]]:
        """Do a task for all photos."""
        return map_photos(self.scene, task, range(len(self.scene.views)), self.graph.threads)
