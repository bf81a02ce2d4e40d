# SPDX-License-Identifier: GPL-3.0-or-later
"""Reference in float64 of ``csrc/stereo/patch_match.c``: pixels of one colour try the planes of pixels around them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SPACING, REACH = 2, 5
_AROUND = ((1, 0), (-1, 0), (0, 1), (0, -1), (REACH, 0), (-REACH, 0), (0, REACH), (0, -REACH))
_SAMPLES = np.array([(SPACING * dx, SPACING * dy) for dy in range(-2, 3) for dx in range(-2, 3)])


@dataclass(frozen=True)
class Neighbour:
    """A photo that is matched with.

    Attributes:
        grey: brightness, [h, w].
        depth: its own depth, 0 where unknown, [h, w].
        between: M and b, flat [12]: (u, v, 1) ~ M (x, y, 1) + b / depth.
    """

    grey: Array
    depth: Array
    between: Array


def move_planes(
    pixels: NDArray[np.int32], grey: Array, others: Sequence[Neighbour], search: np.void, planes: Array
) -> Array:
    """Move the planes of some pixels to the best of what they tried.

    Args:
        pixels: y * width + x, of one colour of the checkerboard, [N].
        grey: brightness of the photo, [h, w].
        others: its neighbours.
        search: as the kernel takes it.
        planes: inverse depth and its slopes, [3, h, w].

    Returns:
        new planes and scores, [4, h, w]; scores of other pixels are -1.
    """
    result = np.concatenate([planes, np.full((1, *grey.shape), -1.0)])
    for pixel in pixels:
        y, x = divmod(int(pixel), grey.shape[1])
        tries = _Tries(x, y, _patch(grey, x, y, search), others, search, planes[:, y, x])
        for dx, dy in _AROUND:
            w, across, down = planes[:, y + dy, x + dx]
            if w > 0:
                tries.add(np.array([w - dx * across - dy * down, across, down]))
        step = 1 / max(1e-6, *(_parallax(other.between, x, y, tries.best[0]) for other in others))
        for number in range(3):
            tries.add(_perturb(tries.best, step, int(pixel), number, search))
        result[:, y, x] = *tries.best, tries.score
    return result


class _Tries:
    """The best of the planes that a pixel tried."""

    def __init__(
        self,
        x: int,
        y: int,
        patch: tuple[Array, Array] | None,
        others: Sequence[Neighbour],
        search: np.void,
        plane: Array,
    ) -> None:
        self.x, self.y, self.patch, self.others, self.search = x, y, patch, others, search
        self.best, self.score = plane, self._score(plane)

    def add(self, plane: Array) -> None:
        score = self._score(plane)
        if score > self.score:
            self.best, self.score = plane, score

    def _score(self, plane: Array) -> float:
        search = self.search
        if self.patch is None or not search["low"] <= plane[0] <= search["high"]:
            return -1.0
        correlations = (_correlation(self.patch, plane, self.x, self.y, other, search) for other in self.others)
        found = sorted(correlations, reverse=True) + [-1.0] * int(search["best"])
        return float(np.mean(found[: int(search["best"])]))


def _patch(grey: Array, x: int, y: int, search: np.void) -> tuple[Array, Array] | None:
    """Return the weights of a patch's pixels and their brightness less its mean, [25] each; None if it is plain."""
    value = grey[y + _SAMPLES[:, 1], x + _SAMPLES[:, 0]].astype(np.float64)
    weight = np.exp(-(((value - grey[y, x]) / search["contrast"]) ** 2))
    value = value - (weight * value).sum() / weight.sum()
    return (weight, value) if (weight * value**2).sum() > search["texture"] ** 2 * weight.sum() else None


def _correlation(patch: tuple[Array, Array], plane: Array, x: int, y: int, other: Neighbour, search: np.void) -> float:
    """Compute the weighted correlation of a patch with what a neighbour shows of its plane, less the cost of depths.

    Args:
        patch: as :func:`_patch` returns it.
        plane: inverse depth at the pixel, and its slopes.
        x: column of the pixel.
        y: row of the pixel.
        other: the neighbour.
        search: as the kernel takes it.

    Returns:
        -1 to 1 less the cost; -1 outside of the neighbour's photo.
    """
    weight, value = patch
    m, b = other.between[:9].reshape(3, 3), other.between[9:]
    carried = m + np.outer(b, (plane[1], plane[2], plane[0] - plane[1] * (x + 0.5) - plane[2] * (y + 0.5)))
    centre = carried @ [x + 0.5, y + 0.5, 1]
    if centre[2] <= 0:
        return -1.0
    middle = centre[:2] / centre[2]
    slope = (carried[:2, :2] - np.outer(middle, carried[2, :2])) / centre[2]
    uv = middle - 0.5 + _SAMPLES @ slope.T
    height, width = other.grey.shape
    reach = 2 * SPACING * np.abs(slope).sum(1)
    if (middle - 0.5 - reach < 0).any() or (middle - 0.5 + reach >= [width - 1, height - 1]).any():
        return -1.0
    i, j = uv.astype(int).T
    s, t = (uv - uv.astype(int)).T
    grey = other.grey.astype(np.float64)
    theirs = (1 - t) * ((1 - s) * grey[j, i] + s * grey[j, i + 1]) + t * (
        (1 - s) * grey[j + 1, i] + s * grey[j + 1, i + 1]
    )
    theirs = theirs - (weight * theirs).sum() / weight.sum()
    squares = (weight * theirs**2).sum()
    result = -1.0
    if squares > search["texture"] ** 2 * weight.sum():
        result = (weight * value * theirs).sum() / np.sqrt(squares * (weight * value**2).sum())
    return float(
        result - search["consistency"] * _inconsistency(other, middle, centre[2] / plane[0], x, y, plane[0], search)
    )


def _inconsistency(
    other: Neighbour, at: Array, expected: float, x: int, y: int, inverse: float, search: np.void
) -> float:
    """Return the distance in pixels between a plane and the neighbour's own depth, at most ``most_off``."""
    if search["consistency"] <= 0:
        return 0.0
    known = other.depth[int(at[1]), int(at[0])]
    most = float(search["most_off"])
    off = abs(expected / known - 1) * _parallax(other.between, x, y, inverse) if known > 0 else most
    return min(off, most)


def _parallax(between: Array, x: int, y: int, inverse: float) -> float:
    """Return the parallax of a pixel in px per relative change of its inverse depth."""
    here, b = between[:9].reshape(3, 3) @ [x + 0.5, y + 0.5, 1], between[9:]
    w = here[2] + b[2] * inverse
    return float(np.hypot(b[0] * here[2] - b[2] * here[0], b[1] * here[2] - b[2] * here[1]) * inverse / w**2)


def _perturb(plane: Array, step: float, pixel: int, number: int, search: np.void) -> Array:
    """Change a plane at random: both depth and slope, or one of them, by the number of the try."""
    r = [_hash_uniform(pixel, int(search["seed"]), 4 * number + k) for k in range(3)]
    w = plane[0] * (1 + (search["shift"] * step * r[0] if number != 1 else 0.0))
    tilt = (search["tilt"] if number else 0.0) * w * search["inverse_focal"].astype(np.float64)
    return np.array([w, plane[1] * w / plane[0] + tilt[0] * r[1], plane[2] * w / plane[0] + tilt[1] * r[2]])


def _hash_uniform(pixel: int, seed: int, draw: int) -> float:
    """Return a random number, -1 to 1, as a hash of its arguments."""
    mask = 0xFFFFFFFF
    h = (pixel * 16 + draw + seed * 0x9E3779B9) & mask
    h ^= h >> 16
    h = h * 0x7FEB352D & mask
    h ^= h >> 15
    h = h * 0x846CA68B & mask
    h ^= h >> 16
    return (h >> 8) * (2 / 16777216) - 1
