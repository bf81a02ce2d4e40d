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

from mgf_engine.masks.around import distance, enlarge, mean_around
from mgf_engine.masks.extent import ground_depth
from mgf_engine.masks.ground import Ground
from mgf_engine.scene.model import Scene, View
from mgf_engine.threads import in_order

PHOTOS, FEWEST = 12, 4  # compared with at most, and at least
#: Degrees between the directions in which two photos see the ground: nearer ones see the building in the same place
#: too, farther ones see another texture. And how much farther away one of them may be.
ANGLES, SCALES = (6.0, 45.0), (0.5, 2.0)
PATCH = 5  # px
#: Share of the photos that must agree, as a mean over the best: bars stand before the ground in the others.
BEST = 0.3
ALIKE = 0.5  # mean normalised cross-correlation of the lightness from which a patch is the same
COLOUR = 12.0  # CIELAB distance, from which it is not
TEXTURE = 0.5  # variance of the lightness below which a patch cannot be compared
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
        """Whether the building is an open one, from some of the views and their masks [H, W]."""

        def share(index: int) -> tuple[int, int]:
            mask = mask_of(index)
            inside = cv2.erode(mask.astype(np.uint8), np.ones((2 * RIM + 1,) * 2, np.uint8)) > 0
            return int((self.within(index, mask) & inside).sum()), int(inside.sum())

        tried = list(views)[:: max(1, len(views) // TRIED)]
        found = [counts for _, counts in in_order(share, tried, threads)]
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
        patches = _Patches(self._lab(index)[box.part])
        fits, colours = _Best(len(others), -1), _Best(len(others), -255)
        level = _Best(ASIDE, -1)
        for row, other in enumerate(others):
            warped, seen = self._through(index, other, self._lab(other), box, self.ground)
            correlation, away = np.where(seen, patches.correlate(warped[..., 0]), -1), patches.away(warped)
            fits.add(np.where(away < COLOUR, correlation, np.minimum(correlation, 0)))
            colours.add(np.where(seen, -away, -255))
            if row >= len(others) - ASIDE:
                level.add(correlation)
        sure = np.isfinite(depth[box.part]) & (fits.mean() > ALIKE)
        if not sure.any():
            return result
        middle = float(np.median(depth[box.part][sure]))
        sure &= self._raised(index, others[-ASIDE:], box, patches, middle) <= level.mean() + BETTER
        dense = cv2.GaussianBlur(sure.astype(np.float32), (0, 0), SPREAD) > DENSE
        result[box.part] = mask[box.part] & dense & (colours.mean() > -COLOUR)
        return _without_specks(result)

    def _read(self, index: int) -> NDArray[np.uint8]:
        return np.asarray(cv2.cvtColor(self.scene.photo(index), cv2.COLOR_RGB2LAB), np.uint8)

    def _others(self, index: int, mask: NDArray[np.bool_], depth: NDArray[np.float64]) -> list[int]:
        """Photos that see the ground behind the mask from beside, the nearest first."""
        rows, columns = np.nonzero(mask & np.isfinite(depth))
        middle = np.argsort(depth[rows, columns])[len(rows) // 2]
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

    def _raised(self, index: int, others: list[int], box: _Box, patches: _Patches, depth: float) -> NDArray[np.float32]:
        """How well planes a little over the ground fit at best, -1..1, [h, w]: the feet of walls lie on one of them."""
        view = self.scene.views[index]
        aside = np.median([np.linalg.norm(self.scene.views[i].centre - view.centre) for i in others])
        over = float(self.ground.height(view.centre[None])[0])
        result = np.full((box.height, box.width), -1, np.float32)
        for pixels in RAISED:
            # Raised by h, the plane comes nearer by h / over of the depth; seen from aside that is a parallax.
            raised = pixels * over * depth / (view.fx * float(aside))
            plane = Ground(self.ground.normal, self.ground.level + raised, self.ground.thickness)
            fits = _Best(len(others), -1)
            for other in others:
                warped, seen = self._through(index, other, self._light(other), box, plane)
                fits.add(np.where(seen, patches.correlate(warped), -1))
            np.maximum(result, fits.mean(), out=result)
        return result

    def _through(
        self, index: int, other: int, picture: NDArray[np.uint8], box: _Box, ground: Ground
    ) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """Another photo, or what was made of it [H, W] or [H, W, 3], as the plane puts it into the box, [h, w] or
        [h, w, 3]; and where it shows anything."""
        matrix = homography(self.scene.views[index], self.scene.views[other], ground)
        matrix = matrix @ np.array([[1, 0, box.left], [0, 1, box.top], [0, 0, 1.0]])
        size, flags = (box.width, box.height), cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        warped = np.asarray(cv2.warpPerspective(picture, matrix, size, flags=flags), np.uint8)
        return warped, inside_frame(matrix, self.scene.views[other], size)


def inside_frame(matrix: NDArray[np.float64], view: View, size: tuple[int, int]) -> NDArray[np.bool_]:
    """Pixels (x, y) of a picture of a size that a homography [3, 3] puts inside the frame of a view, before it, [h, w].

    Along a row all that has to hold is linear in x, so what is inside is one span of it.
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
    x = np.arange(width)
    return np.asarray((x >= first[:, None]) & (x <= last[:, None]), bool)


class _Best:
    """The mean of the best of some maps, kept while they come.

    Args:
        count: of the maps; the best :data:`BEST` of them count. worst: the value of a map that says nothing.
    """

    def __init__(self, count: int, worst: float) -> None:
        self._wanted = max(FEWEST - 1, round(BEST * count))
        self._worst = np.float32(worst)
        self._ranked: list[NDArray[np.float32]] = []

    def add(self, values: NDArray[np.floating]) -> None:
        """One more map [h, w]."""
        new = values.astype(np.float32)
        for slot in self._ranked:
            lower = np.minimum(slot, new)
            np.maximum(slot, new, out=slot)
            new = lower
        if len(self._ranked) < self._wanted:
            self._ranked.append(new)

    def mean(self) -> NDArray[np.float32]:
        """Of the best, [h, w]."""
        missing = (self._wanted - len(self._ranked)) * self._worst
        return np.asarray((np.sum(self._ranked, axis=0) + missing) / self._wanted, np.float32)


class _Patches:
    """A photo's patches, ready to be compared with others: uint8 CIELAB [h, w, 3]."""

    def __init__(self, lab: NDArray[np.uint8]) -> None:
        self.lightness, self.colour = _lightness(lab[..., 0]), _smooth(lab)
        self.average = _mean(self.lightness)
        self.variance = _mean(self.lightness**2) - self.average**2

    def correlate(self, light: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Normalised cross-correlation with another lightness [h, w], -1..1, 0 where there is no texture, [h, w]."""
        other = _lightness(light)
        average = _mean(other)
        variance = _mean(other**2) - average**2
        shared = _mean(self.lightness * other) - self.average * average
        enough = (self.variance > TEXTURE) & (variance > TEXTURE)
        return np.where(enough, shared / np.sqrt(np.maximum(self.variance * variance, TEXTURE**2)), 0)

    def away(self, lab: NDArray[np.uint8]) -> NDArray[np.float32]:
        """CIELAB distance, [h, w]."""
        return distance(self.colour, _smooth(lab))


def _alike_around(lab: NDArray[np.uint8], ground: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels near to the ground whose colour is as near to its mean around them as most of its own, [H, W]."""
    if not ground.any():
        return ground
    colour = _smooth(lab)
    away = distance(colour, enlarge(mean_around(colour, ground, REACH).colour, ground.shape))
    return np.asarray(near_ground(ground) & (away < np.percentile(away[ground], USUAL)), bool)


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
    own = np.array([[view.fx, 0, view.cx - 0.5], [0, view.fy, view.cy - 0.5], [0, 0, 1]])
    others = np.array([[other.fx, 0, other.cx - 0.5], [0, other.fy, other.cy - 0.5], [0, 0, 1]])
    return np.asarray(others @ matrix @ np.linalg.inv(own), np.float64)


def _box_of(mask: NDArray[np.bool_]) -> _Box | None:
    if not mask.any():
        return None
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    return _Box(int(rows[0]), int(columns[0]), int(rows[-1] - rows[0] + 1), int(columns[-1] - columns[0] + 1))


def _lightness(light: NDArray[np.uint8]) -> NDArray[np.float32]:
    """0..100."""
    return light.astype(np.float32) * np.float32(100 / 255)


def _smooth(lab: NDArray[np.uint8]) -> NDArray[np.float32]:
    """CIELAB, means of 3 x 3 pixels."""
    return np.asarray(cv2.transform(cv2.blur(lab, (3, 3)).astype(np.float32), np.diag([100 / 255, 1, 1])), np.float32)


def _mean(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Over the patch around each pixel."""
    return np.asarray(cv2.blur(image, (PATCH, PATCH)), np.float32)


def _without_specks(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    _, pieces, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    large = stats[:, cv2.CC_STAT_AREA] >= SMALLEST
    large[0] = False
    return np.asarray(large[pieces], bool)
