# SPDX-License-Identifier: GPL-3.0-or-later
"""Ground that shows through the building: between the bars of a frame, under a bridge or an arch.

A mask is drawn around such parts as a whole, and what is trained on the ground behind them would hang in the air as
clumps. Where a pixel shows the plane of the ground, other photos show the same texture where the plane puts it; where
it shows the building before the plane, they show something else. No region of a photo is as fine as the gaps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.geometry.building_extent import ground_depth
from mgf_engine.masks.geometry.ground_plane import Ground
from mgf_engine.masks.image_ops import distance, enlarge, masked_mean
from mgf_engine.masks.refinement.patch_ncc import Patches
from mgf_engine.model.scene import Scene, View
from mgf_engine.native.parallel import parallel_map

PHOTOS, FEWEST = 12, 4  # compared with at most, and at least
#: Degrees between the directions in which two photos see the ground: nearer ones see the building in the same place
#: too, farther ones see another texture. And how much farther away one of them may be.
ANGLES, SCALES = (6.0, 45.0), (0.5, 2.0)
#: Share of the photos that must agree, as a mean over the best: bars stand before the ground in the others.
BEST = 0.3
ALIKE = 0.5  # mean normalised cross-correlation of the lightness from which a patch is the same
COLOUR = 12.0  # CIELAB distance, from which it is not
#: Planes over the ground that must fit worse, by how many pixels they move in the other photos: at the foot of a wall
#: the ground fits nearly as well as the wall. And how many photos, those farthest aside, are asked.
RAISED, ASIDE, BETTER = (1.5, 4.0, 9.0), 5, 0.05
SPREAD, DENSE = 2.5, 0.35  # px, and share of alike pixels around a pixel of the ground
SMALLEST = 12  # px
#: Pixels so near to found ground and as near to its colour as this share of it (in percent) may be ground, too.
REACH, USUAL = 8, 90
#: Photos that are tried, and the share of their masks' inside, so many px from the edge, that must be ground for the
#: building to be an open one. Closed buildings have ground at the edge alone, where the masks are as good without.
TRIED, OPEN, RIM = 12, 0.03, 4


@dataclass(frozen=True)
class Through:
    """One photo, bool [H, W] each: pixels of the mask that show the ground, and those that may."""

    certain: NDArray[np.bool_]
    possible: NDArray[np.bool_]


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


class GroundSeen:
    """Finds the ground in masks by comparing photos through the plane of the ground.

    Args:
        ground: normalised frame.
    """

    def __init__(self, scene: Scene, ground: Ground) -> None:
        self.scene, self.ground = scene, ground
        self._lab: Callable[[int], NDArray[np.uint8]] = lru_cache(4 * PHOTOS)(self._read)
        self._light: Callable[[int], NDArray[np.uint8]] = lru_cache(4 * PHOTOS)(lambda i: self._lab(i)[..., 0].copy())

    def shows_through(
        self, views: Sequence[int], mask_of: Callable[[int], NDArray[np.bool_]], threads: int = 1
    ) -> bool:
        """Tell whether the building is an open structure, from some of the views and their masks [H, W]."""

        def share(index: int) -> tuple[int, int]:
            mask = mask_of(index)
            inside = cv2.erode(mask.astype(np.uint8), np.ones((2 * RIM + 1,) * 2, np.uint8)) > 0
            return int((self.within(index, mask) & inside).sum()), int(inside.sum())

        tried = list(views)[:: max(1, len(views) // TRIED)]
        found = list(parallel_map(share, tried, threads))
        return sum(ground for ground, _ in found) > OPEN * sum(total for _, total in found)

    def through(self, index: int, mask: NDArray[np.bool_]) -> Through:
        """The ground in a mask [H, W], and what is near to it and has its colour."""
        certain = self.within(index, mask)
        return Through(certain, mask & ~certain & _alike_around(self._lab(index), certain))

    def within(self, index: int, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Pixels of a mask [H, W] in which other photos confirm the ground, [H, W]."""
        result = np.zeros_like(mask)
        view = self.scene.views[index]
        depth = ground_depth(view, self.ground, view.height, view.width)
        box = _box_of(mask & np.isfinite(depth))
        others = self._others(index, mask, depth) if box is not None else []
        if box is None or len(others) < FEWEST:
            return result
        patches = Patches(self._lab(index)[box.part])
        pictures, seen = self._through(index, others, self._lab, box, self.ground)
        fits, colours, level = patches.compare(
            pictures, seen, _counting(len(others)), COLOUR, min(ASIDE, len(others)), _counting(ASIDE)
        )
        sure = np.isfinite(depth[box.part]) & (fits > ALIKE)
        if not sure.any():
            return result
        middle = float(np.median(depth[box.part][sure]))
        sure &= self._raised(index, others[-ASIDE:], box, patches, middle) <= level + BETTER
        dense = cv2.GaussianBlur(sure.astype(np.float32), (0, 0), SPREAD) > DENSE
        result[box.part] = mask[box.part] & dense & (colours > -COLOUR)
        return _without_specks(result)

    def _read(self, index: int) -> NDArray[np.uint8]:
        return np.asarray(cv2.cvtColor(self.scene.photo(index), cv2.COLOR_RGB2LAB), np.uint8)

    def _others(self, index: int, mask: NDArray[np.bool_], depth: NDArray[np.float64]) -> list[int]:
        """Photos that see the ground behind the mask from beside, the nearest first."""
        rows, columns = np.nonzero(mask & np.isfinite(depth))
        middle = np.argpartition(depth[rows, columns], len(rows) // 2)[len(rows) // 2]
        view = self.scene.views[index]
        ray = np.array([(columns[middle] + 0.5 - view.cx) / view.fx, (rows[middle] + 0.5 - view.cy) / view.fy, 1.0])
        spot = view.centre + view.rotation.T @ ray * depth[rows[middle], columns[middle]]
        towards = np.stack([v.centre for v in self.scene.views]) - spot
        length = np.linalg.norm(towards, axis=1)
        towards /= length[:, None]
        angle = np.degrees(np.arccos(np.clip(towards @ towards[index], -1, 1)))
        scale = length / length[index]
        good = (angle > ANGLES[0]) & (angle < ANGLES[1]) & (scale > SCALES[0]) & (scale < SCALES[1])
        return [int(i) for i in np.argsort(angle, kind="stable") if good[i]][:PHOTOS]

    def _raised(self, index: int, others: list[int], box: _Box, patches: Patches, depth: float) -> NDArray[np.float32]:
        """Compute the best correlation of planes a little over the ground, -1..1, [h, w]: feet of walls lie on one."""
        view = self.scene.views[index]
        aside = np.median([np.linalg.norm(self.scene.views[i].centre - view.centre) for i in others])
        over = float(self.ground.height(view.centre[None])[0])
        result = np.full((box.height, box.width), -1, np.float32)
        for pixels in RAISED:
            # Raised by h, the plane comes nearer by h / over of the depth; seen from aside that is a parallax.
            raised = pixels * over * depth / (view.fx * float(aside))
            plane = Ground(self.ground.normal, self.ground.level + raised, self.ground.thickness)
            lights, seen = self._through(index, others, self._light, box, plane)
            np.maximum(result, patches.correlate(lights, seen, _counting(len(others))), out=result)
        return result

    def _through(
        self, index: int, others: list[int], picture: Callable[[int], NDArray[np.uint8]], box: _Box, ground: Ground
    ) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
        """Other photos, or what was made of them [H, W] or [H, W, 3], as the plane puts them into the box.

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


def spans_inside(matrix: NDArray[np.float64], view: View, size: tuple[int, int]) -> NDArray[np.int32]:
    """Pixels of a picture of a size (w, h) that a homography [3, 3] puts inside the frame of a view, before it.

    Along a row all that has to hold is linear in x, so what is inside is one span of it.

    Returns:
        the first and one past the last pixel of each row, [h, 2]; the same or less where there is none.
    """
    width, height = size
    u, v, w = matrix
    rules = np.stack([w, u, v, (view.width - 1) * w - u, (view.height - 1) * w - v])  # each at least 0, w above
    at_zero = rules[:, 1:2] * np.arange(height) + rules[:, 2:] - np.array([[1e-9], [0], [0], [0], [0]])
    slope = rules[:, :1]
    with np.errstate(divide="ignore", invalid="ignore"):
        zero = -at_zero / slope
    first = np.where(slope > 0, zero, np.where((slope == 0) & (at_zero < 0), np.inf, -np.inf)).max(0)
    last = np.where(slope < 0, zero, np.inf).min(0)
    ends = np.stack([np.ceil(first), np.floor(last) + 1], 1)
    return np.clip(ends, 0, width).astype(np.int32)


def _counting(photos: int) -> int:
    """Return how many of the best photos count; at least :data:`FEWEST` are compared."""
    return max(FEWEST - 1, round(BEST * photos))


def _alike_around(lab: NDArray[np.uint8], ground: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels near to the ground whose colour is as near to its mean around them as most of its own, [H, W]."""
    result, near = np.zeros_like(ground), near_ground(ground)
    box = _box_of(near)
    if box is None:
        return result
    # A mean reaches less far than this: what is beyond the part changes nothing.
    top, left = max(0, box.top - 5 * REACH), max(0, box.left - 5 * REACH)
    part = slice(top, box.top + box.height + 5 * REACH), slice(left, box.left + box.width + 5 * REACH)
    here, colour = ground[part], _smooth(np.ascontiguousarray(lab[part]))
    away = distance(colour, enlarge(masked_mean(colour, here, REACH).colour, here.shape))
    result[part] = near[part] & (away < np.percentile(away[here], USUAL))
    return result


def near_ground(ground: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels of the ground and around it, [H, W]."""
    return np.asarray(cv2.dilate(ground.astype(np.uint8), np.ones((2 * REACH + 1,) * 2, np.uint8)) > 0, bool)


def homography(view: View, other: View, ground: Ground) -> NDArray[np.float64]:
    """[3, 3], pixel indices of ``view`` -> those of ``other``, for what lies on the plane; w > 0 before the camera."""
    turn = other.rotation @ view.rotation.T
    shift = other.rotation @ (view.centre - other.centre)
    height = float(ground.height(view.centre[None])[0])
    # A ray d of the view meets the plane at d * (height / -(normal . d)).
    matrix = turn * height - np.outer(shift, view.rotation @ ground.normal)
    to_index = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]])  # of the pixel whose centre is there
    own, others = to_index @ view.intrinsics, to_index @ other.intrinsics
    return np.asarray(others @ matrix @ np.linalg.inv(own), np.float64)


def _box_of(mask: NDArray[np.bool_]) -> _Box | None:
    if not mask.any():
        return None
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    return _Box(int(rows[0]), int(columns[0]), int(rows[-1] - rows[0] + 1), int(columns[-1] - columns[0] + 1))


def _smooth(lab: NDArray[np.uint8]) -> NDArray[np.float32]:
    """CIELAB, means of 3 x 3 pixels."""
    return np.asarray(cv2.transform(cv2.blur(lab, (3, 3)).astype(np.float32), np.diag([100 / 255, 1, 1])), np.float32)


def _without_specks(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    _, pieces, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    large = stats[:, cv2.CC_STAT_AREA] >= SMALLEST
    large[0] = False
    return np.asarray(large[pieces], bool)
