# SPDX-License-Identifier: GPL-3.0-or-later
"""Find ground visible through the building (between bars, under an arch) by homographies of the ground plane.

The masks are drawn around such parts as a whole; training on the ground behind them would make clumps of Gaussians in
the air. If a pixel shows the ground, the homography of the ground plane maps it to the same texture in other photos; if
it shows the building in front of it, it does not. This works pixel by pixel: superpixels are coarser than the gaps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.geometry.ground_plane import GroundPlane
from mgf_engine.masks.geometry.plane_homography import homography, spans_inside
from mgf_engine.masks.image_ops import color_distance, dilate_square, disc, enlarge, erode_square, masked_mean
from mgf_engine.masks.refinement.lab_photos import LabPhotos
from mgf_engine.masks.refinement.patch_ncc import Patches
from mgf_engine.model.scene import Scene
from mgf_engine.native.parallel import parallel_map
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class GroundHomographyOptions:
    """Options of ground that shows through the building; distances of colours are in CIELAB."""

    photos: int = parameter(12, "Maximum number of photos that a photo is compared with", low=1)
    least_photos: int = parameter(4, "Minimum number of photos", low=2)
    angles: tuple[float, float] = parameter(
        (6.0, 45.0), "Angle between the directions in which two photos see the ground", "degrees"
    )
    scales: tuple[float, float] = parameter((0.5, 2.0), "Ratio of the distances of two photos from the ground")
    best: float = parameter(0.3, "Share of the photos, the best ones, that must agree on average", high=1)
    correlation: float = parameter(0.5, "Minimum normalised cross-correlation of patches", high=1)
    texture: float = parameter(0.5, "Minimum variance of a patch's lightness")
    color: float = parameter(12.0, "Maximum colour distance of patches")
    raised: tuple[float, float, float] = parameter(
        (1.5, 4.0, 9.0), "Parallax of planes above the ground, which must fit worse than the ground", "px"
    )
    aside: int = parameter(
        5, "Number of photos, those with the largest viewing angle, compared through the raised planes", low=1
    )
    better: float = parameter(0.05, "Correlation by which a raised plane may fit better than the ground")
    distinct: float = parameter(
        0.2, "Correlation by which the highest raised plane must fit worse: boards along the ground fit all of them"
    )
    spread: float = parameter(
        2.5, "Standard deviation of the window in which confirmed pixels of the ground are counted", "px", low=0.1
    )
    dense: float = parameter(0.35, "Minimum share of confirmed pixels in the counting window", high=1)
    smallest: int = parameter(12, "Minimum area of a piece of ground", "px²")
    reach: int = parameter(8, "Distance from confirmed ground in which pixels are possible ground", "px", low=1)
    usual: float = parameter(
        90.0,
        "Percentile of the colour distances of confirmed ground up to which pixels within reach are possible ground",
        high=100,
    )
    tried: int = parameter(12, "Number of photos that decide whether the building is open", low=1)
    open_share: float = parameter(0.03, "Share of the masks' inside that must be ground for an open building", high=1)
    rim: int = parameter(4, "Distance from the edge from which a pixel counts as inside", "px")
    width: int = parameter(
        9, "Minimum width of a piece of ground in the mask of a closed building; strips are feet of walls", "px", low=1
    )
    share: float = parameter(0.01, "Minimum area of such a piece, as a share of the mask", high=1)


@dataclass(frozen=True)
class GroundPixels:
    """The ground in one photo.

    Attributes:
        certain: bool [H, W], pixels of the mask that show the ground.
        possible: bool [H, W], those that may.
        reach: distance from the ground in px within which its colour was compared.
    """

    certain: NDArray[np.bool_]
    possible: NDArray[np.bool_]
    reach: int = GroundHomographyOptions.reach


@dataclass(frozen=True)
class _Box:
    """A part of a photo: its rows and columns."""

    top: int
    left: int
    height: int
    width: int

    @property
    def part(self) -> tuple[slice, slice]:
        return slice(self.top, self.top + self.height), slice(self.left, self.left + self.width)


class GroundFinder:
    """Finds the ground in masks by comparing photos through the plane of the ground.

    Args:
        photos: of the scene, in CIELAB.
        ground: normalised frame.
        options: which photos are compared, and how alike they must be.
        confirmed: (view, ground found in it [H, W]) -> what of it is no mirror image; all of it by default.
    """

    def __init__(
        self,
        photos: LabPhotos,
        ground: GroundPlane,
        options: GroundHomographyOptions = GroundHomographyOptions(),
        confirmed: Callable[[int, NDArray[np.bool_]], NDArray[np.bool_]] = lambda index, found: found,
    ) -> None:
        self.options, self._confirmed = options, confirmed
        self.photos, self.ground = photos, ground
        self.scene: Scene = photos.scene

    def is_open_structure(
        self, views: Sequence[int], mask_of: Callable[[int], NDArray[np.bool_]], threads: int = 1
    ) -> bool:
        """Tell whether the ground shows through the building, from some of the views and their masks [H, W]."""

        def share(index: int) -> tuple[int, int]:
            mask = mask_of(index)
            inside = erode_square(mask, self.options.rim)
            return int((self.confirmed_ground(index, mask) & inside).sum()), int(inside.sum())

        tried = list(views)[:: max(1, len(views) // self.options.tried)]
        found = list(parallel_map(share, tried, threads))
        return sum(ground for ground, _ in found) > self.options.open_share * sum(total for _, total in found)

    def find_ground_pixels(self, index: int, mask: NDArray[np.bool_]) -> GroundPixels:
        """Return the ground in a mask [H, W], and what is near to it and has its colour."""
        return self._with_possible(index, mask, self.confirmed_ground(index, mask))

    def find_wide_pieces(self, index: int, mask: NDArray[np.bool_]) -> GroundPixels:
        """Return the ground below parts that hang over, in the mask [H, W] of a building that is closed.

        Feet of walls are too near to the ground to be told from it, so that only wide and large pieces count.
        """
        found = self.confirmed_ground(index, mask).astype(np.uint8)
        wide = cv2.morphologyEx(found, cv2.MORPH_OPEN, disc(self.options.width // 2))
        return self._with_possible(index, mask, _without_specks(wide > 0, self.options.share * float(mask.sum())))

    def _with_possible(self, index: int, mask: NDArray[np.bool_], certain: NDArray[np.bool_]) -> GroundPixels:
        """Add to the certain ground [H, W] what is near to it in the mask and has its colour."""
        near = mask & ~certain & _alike_around(self.photos.lab(index), certain, self.options)
        return GroundPixels(certain, near, self.options.reach)

    def confirmed_ground(self, index: int, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return pixels of a mask [H, W] in which other photos confirm the ground, [H, W]."""
        result = np.zeros_like(mask)
        view = self.scene.views[index]
        depth = self.ground.depth(view, view.height, view.width)
        box = _box_of(mask & np.isfinite(depth))
        others = self._others(index, mask, depth) if box is not None else []
        if box is None or len(others) < self.options.least_photos:
            return result
        patches = Patches(self.photos.lab(index)[box.part], self.options.texture)
        pictures, seen = self._warp(index, others, self.photos.lab, box, self.ground)
        fits, colors, level = patches.compare(
            pictures,
            seen,
            _counting(len(others), self.options),
            self.options.color,
            min(self.options.aside, len(others)),
            _counting(self.options.aside, self.options),
        )
        sure = np.isfinite(depth[box.part]) & (fits > self.options.correlation)
        if not sure.any():
            return result
        middle = float(np.median(depth[box.part][sure]))
        raised = self._raised(index, others[-self.options.aside :], box, patches, middle)
        sure &= raised.max(0) <= level + self.options.better
        sure &= raised[-1] <= level - self.options.distinct
        dense = cv2.GaussianBlur(sure.astype(np.float32), (0, 0), self.options.spread) > self.options.dense
        result[box.part] = mask[box.part] & dense & (colors > -self.options.color)
        return self._confirmed(index, _without_specks(result, self.options.smallest))

    def _others(self, index: int, mask: NDArray[np.bool_], depth: NDArray[np.float64]) -> list[int]:
        """Return photos that see the ground behind the mask from beside, the nearest first."""
        rows, columns = np.nonzero(mask & np.isfinite(depth))
        middle = np.argpartition(depth[rows, columns], len(rows) // 2)[len(rows) // 2]
        pixel, away = np.array([[columns[middle] + 0.5, rows[middle] + 0.5]]), depth[rows[middle], columns[middle]]
        spot = self.scene.views[index].unproject(pixel, away[None])
        towards = np.stack([v.centre for v in self.scene.views]) - spot
        length = np.linalg.norm(towards, axis=1)
        towards /= length[:, None]
        angle = np.degrees(np.arccos(np.clip(towards @ towards[index], -1, 1)))
        scale = length / length[index]
        good = (
            (angle > self.options.angles[0])
            & (angle < self.options.angles[1])
            & (scale > self.options.scales[0])
            & (scale < self.options.scales[1])
        )
        return [int(i) for i in np.argsort(angle, kind="stable") if good[i]][: self.options.photos]

    def _raised(self, index: int, others: list[int], box: _Box, patches: Patches, depth: float) -> NDArray[np.float32]:
        """Compute the correlations of planes a little over the ground, -1..1, [n, h, w]: feet of walls lie on one."""
        view = self.scene.views[index]
        aside = np.median([np.linalg.norm(self.scene.views[i].centre - view.centre) for i in others])
        over = float(self.ground.height(view.centre[None])[0])
        result = np.empty((len(self.options.raised), box.height, box.width), np.float32)
        for row, pixels in enumerate(self.options.raised):
            # Raised by h, the plane comes nearer by h / over of the depth; seen from aside that is a parallax.
            raised = pixels * over * depth / (view.fx * float(aside))
            plane = GroundPlane(self.ground.normal, self.ground.level + raised, self.ground.thickness)
            lights, seen = self._warp(index, others, self.photos.lightness, box, plane)
            result[row] = patches.correlate(lights, seen, _counting(len(others), self.options))
        return result

    def _warp(
        self, index: int, others: list[int], picture: Callable[[int], NDArray[np.uint8]], box: _Box, ground: GroundPlane
    ) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
        """Return other photos, or what was made of them [H, W] or [H, W, 3], as the plane puts them into the box.

        Returns:
            [n, h, w] or [n, h, w, 3], and where they show anything, [n, h, 2], see :func:`spans_inside`.
        """
        size, flags = (box.width, box.height), cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        corner = np.array([[1, 0, box.left], [0, 1, box.top], [0, 0, 1.0]])
        warped = np.empty((len(others), box.height, box.width, *picture(index).shape[2:]), np.uint8)
        seen = np.empty((len(others), box.height, 2), np.int32)
        for row, other in enumerate(others):
            matrix = homography(self.scene.views[index], self.scene.views[other], ground) @ corner
            cv2.warpPerspective(picture(other), matrix, size, dst=warped[row], flags=flags)
            seen[row] = spans_inside(matrix, self.scene.views[other], size)
        return warped, seen


def _counting(photos: int, options: GroundHomographyOptions) -> int:
    """Return how many of the best photos count; at least ``least_photos`` of the options are compared."""
    return max(options.least_photos - 1, round(options.best * photos))


def _alike_around(
    lab: NDArray[np.uint8], ground: NDArray[np.bool_], options: GroundHomographyOptions
) -> NDArray[np.bool_]:
    """Find pixels near the ground whose colour is as close to its local mean as most of the ground's pixels, [H, W]."""
    result, near = np.zeros_like(ground), near_ground(ground, options.reach)
    box = _box_of(near)
    if box is None:
        return result
    # A mean reaches less far than this: what is beyond the part changes nothing.
    top, left = max(0, box.top - 5 * options.reach), max(0, box.left - 5 * options.reach)
    part = slice(top, box.top + box.height + 5 * options.reach), slice(left, box.left + box.width + 5 * options.reach)
    here, color = ground[part], _smooth(np.ascontiguousarray(lab[part]))
    away = color_distance(color, enlarge(masked_mean(color, here, options.reach).color, here.shape))
    result[part] = near[part] & (away < np.percentile(away[here], options.usual))
    return result


def near_ground(ground: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """Return pixels of the ground and up to ``reach`` px around it, [H, W]."""
    return dilate_square(ground, reach)


def _box_of(mask: NDArray[np.bool_]) -> _Box | None:
    if not mask.any():
        return None
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    return _Box(int(rows[0]), int(columns[0]), int(rows[-1] - rows[0] + 1), int(columns[-1] - columns[0] + 1))


def _smooth(lab: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return CIELAB, means of 3 x 3 pixels."""
    return np.asarray(cv2.transform(cv2.blur(lab, (3, 3)).astype(np.float32), np.diag([100 / 255, 1, 1])), np.float32)


def _without_specks(mask: NDArray[np.bool_], smallest: float) -> NDArray[np.bool_]:
    """Return the pieces of a mask [H, W] that are no smaller, in px²."""
    _, pieces, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    large = stats[:, cv2.CC_STAT_AREA] >= smallest
    large[0] = False
    return np.asarray(large[pieces], bool)
