# SPDX-License-Identifier: GPL-3.0-or-later
"""Reference in float64 of ``csrc/stereo/match.c``: correlation of patches between two photos for several depths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.mesh.photometric import MatchOptions

Array = NDArray[np.float64]
RADIUS = 2


def depth_steps(
    pixels: NDArray[np.int32], depth: Array, between: Sequence[Array], length: float, limit: float
) -> Array:
    """Compute the relative change [N] of the inverse depth that moves ``pixels`` by ``length`` in the other photo.

    Args:
        pixels: flat indices, [N].
        depth: of the first photo, [H, W].
        between: of each neighbour, as in :class:`PhotoPair`.
        length: px, by which a pixel moves in the neighbour where it moves most.
        limit: largest relative change.
    """
    rows, columns = np.divmod(pixels, depth.shape[1])
    places = np.stack([columns + 0.5, rows + 0.5, np.ones(len(pixels))], 1)
    inverse = 1 / depth[rows, columns]
    most = np.full(len(pixels), 1e-6)
    for m in between:
        q = [places @ m[:9].reshape(3, 3).T + m[9:] * (inverse * factor)[:, None] for factor in (1 - 1e-5, 1 + 1e-5)]
        moved = np.linalg.norm(q[1][:, :2] / q[1][:, 2:] - q[0][:, :2] / q[0][:, 2:], axis=1) / 2e-5
        most = np.where(q[0][:, 2] > 0, np.maximum(most, moved), most)
    return np.asarray(np.minimum(length / most, limit))


@dataclass(frozen=True)
class PhotoPair:
    """A photo and its neighbour.

    Attributes:
        first, other: (brightness, depth) of each photo, [H, W] each.
        inverse_intrinsics: 1 / fx, 1 / fy, cx, cy of the first photo.
        between: M and b, flat [12]: (u, v, 1) ~ M (x, y, 1) + b / depth.
    """

    first: tuple[Array, Array]
    other: tuple[Array, Array]
    inverse_intrinsics: Array
    between: Array


def match_depths(
    pair: PhotoPair,
    pixels: NDArray[np.int32],
    normals: Array,
    step: Array,
    options: MatchOptions,
) -> tuple[Array, Array]:
    """Correlate the patches around ``pixels`` [N], [N, steps], and give 1 or 0 [N] whether the neighbour has a say.

    Args:
        pair: the photos.
        pixels: flat indices, [N].
        normals: [N, 3], first camera's frame.
        step: relative change of the inverse depth from one try to the next, [N].
        options: number of tries, and which pixels can be compared.
    """
    first, other, between = pair.first, pair.other, pair.between
    scores, counts = np.zeros((len(pixels), options.steps)), np.zeros(len(pixels))
    for n, pixel in enumerate(pixels):
        y, x = divmod(int(pixel), first[0].shape[1])
        plane = _plane(x, y, first[1][y, x], normals[n], pair.inverse_intrinsics)
        if plane is None or not _sees(x, y, first[1][y, x], between, other[1], options.hidden):
            continue
        window = _window(x, y, plane, first, options.jump, options.texture)
        if window is None:
            continue
        factors = 1 + (np.arange(options.steps) - options.steps // 2) * step[n]
        found = [_correlation(window, plane * factor, between, other[0], options.texture) for factor in factors]
        if all(f is not None for f in found):
            scores[n], counts[n] = found, 1
    return scores, counts


def _plane(x: int, y: int, depth: float, normal: Array, inverse: Array) -> Array | None:
    """Return the plane's inverse depth as a linear function of (x, y, 1)."""
    to_ray = np.array([[inverse[0], 0, -inverse[2] * inverse[0]], [0, inverse[1], -inverse[3] * inverse[1]], [0, 0, 1]])
    per_pixel = normal @ to_ray
    facing = per_pixel @ [x + 0.5, y + 0.5, 1] * depth
    return per_pixel / facing if depth > 0 and facing < 0 else None


def _sees(x: int, y: int, depth: float, between: Array, other_depth: Array, hidden: float) -> bool:
    q = between[:9].reshape(3, 3) @ [x + 0.5, y + 0.5, 1] * depth + between[9:]
    if q[2] <= 0:
        return False
    u, v = q[:2] / q[2]
    height, width = other_depth.shape
    return bool(0 <= u < width and 0 <= v < height and abs(other_depth[int(v), int(u)] - q[2]) < hidden * q[2])


def _window(
    x: int, y: int, plane: Array, first: tuple[Array, Array], jump: float, texture: float
) -> tuple[Array, Array, Array] | None:
    """Return pixels [25, 3] of the patch, their weights and grey less its mean; None without texture or surface."""
    height, width = first[0].shape
    if not (RADIUS <= x < width - RADIUS and RADIUS <= y < height - RADIUS):
        return None
    rows, columns = np.mgrid[y - RADIUS : y + RADIUS + 1, x - RADIUS : x + RADIUS + 1].reshape(2, -1)
    places = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], 1)
    weight = (np.abs(first[1][rows, columns] * (places @ plane) - 1) < jump).astype(float)
    grey = first[0][rows, columns]
    if weight.sum() < 0.5 * len(rows):
        return None
    grey = grey - (weight * grey).sum() / weight.sum()
    return (places, weight, grey) if (weight * grey**2).sum() > texture**2 * weight.sum() else None


def _correlation(
    window: tuple[Array, Array, Array], plane: Array, between: Array, other: Array, texture: float
) -> float | None:
    places, weight, grey = window
    carried = between[:9].reshape(3, 3) + np.outer(between[9:], plane)
    centre = carried @ places.mean(0)
    if centre[2] <= 0:
        return None
    middle = centre[:2] / centre[2]
    slope = (carried[:2, :2] - np.outer(middle, carried[2, :2])) / centre[2]  # the homography's derivative there
    uv = middle + (places - places.mean(0))[:, :2] @ slope.T - 0.5
    height, width = other.shape
    if (uv < 0).any() or (uv[:, 0] >= width - 1).any() or (uv[:, 1] >= height - 1).any():
        return None
    i, j = uv.astype(int).T
    a, b = (uv - uv.astype(int)).T
    value = (1 - b) * ((1 - a) * other[j, i] + a * other[j, i + 1])
    value += b * ((1 - a) * other[j + 1, i] + a * other[j + 1, i + 1])
    value -= (weight * value).sum() / weight.sum()
    squares = (weight * value**2).sum()
    if squares <= texture**2 * weight.sum():
        return -1.0
    return float((weight * value * grey).sum() / np.sqrt(squares * (weight * grey**2).sum()))
