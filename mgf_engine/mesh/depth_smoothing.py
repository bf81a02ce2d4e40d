# SPDX-License-Identifier: GPL-3.0-or-later
"""Second-order smoothing of depth maps, weighted by how precisely photos tell each depth.

Inverse depth is linear in the pixels of a plane, so its second differences tell relief, creases and noise from flat
places without knowing any plane. Their robust norm lets creases be (iteratively reweighted least squares; second-order
priors as in Woodford et al. 2009); photos hold each pixel as firmly as their correlation peaks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.mesh.photometric import Matched

Array = NDArray[np.float32]


@dataclass(frozen=True)
class SmoothingOptions:
    """How depth maps are smoothed; px are pixels of parallax in the neighbour that sees the most of it."""

    strength: float = 20.0  # weight of squared second differences beside a depth of precision 1 px^-2
    crease: float = 0.15  # px, second difference from which it counts as a crease rather than as noise
    jump: float = 2.0  # px, second difference from which pixels show surfaces that are not joined
    unmatched: float = 0.05  # precision of depths that no photo tells, as a share of the median of the others
    rounds: int = 3  # of reweighting
    steps: int = 12  # of conjugate gradients in each


def smooth_depth(start: Array, matched: Matched, options: SmoothingOptions = SmoothingOptions()) -> Array:
    """Smooth a matched depth map where photos tell its depths less precisely than their neighbours do.

    Args:
        start: depth that jumps are judged by, 0 where there is no surface, float32 [H, W].

    Returns:
        Depths, float32 [H, W]; as matched where there is no surface, and where photos tell no depth at all.
    """
    shown = (start > 0) & (matched.parallax > 0)
    told = matched.precision[shown & (matched.precision > 0)]
    if not len(told):
        return matched.depth
    box = _box(shown)
    inside, scale = shown[box], float(np.median(matched.parallax[shown] / start[shown]))
    depth = np.where(inside, matched.depth[box], 1)
    target = np.where(inside, 1 / (scale * depth.astype(np.float64)), 0)
    first = np.where(inside, 1 / (scale * np.where(inside, start[box], 1)), 0)
    least = options.unmatched * float(np.median(told))
    weight = np.where(inside, np.maximum(matched.precision[box], least), 0)
    joined = [_inside_triples(inside, axis) & (np.abs(_second(first, axis)) < options.jump) for axis in (0, 1)]
    found = target
    for _ in range(options.rounds):
        bends = [
            np.where(j, options.strength / np.sqrt(1 + (_second(found, axis) / options.crease) ** 2), 0)
            for axis, j in enumerate(joined)
        ]
        found = _solve(weight, bends, target, found, options.steps)
    result = matched.depth.copy()
    # What conjugate gradients have not reached yet stays within the jump that joins pixels.
    found = np.clip(found, target - options.jump, target + options.jump)
    result[box] = np.where(inside & (found > 0), 1 / (scale * np.where(found > 0, found, 1)), result[box])
    return result


def _box(shown: NDArray[np.bool_]) -> tuple[slice, slice]:
    rows, columns = np.flatnonzero(shown.any(1)), np.flatnonzero(shown.any(0))
    return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)


def _second(values: Array, axis: int) -> Array:
    """Second differences along an axis, which is shorter by two."""
    v = values if axis == 0 else values.T
    d = v[:-2] - 2 * v[1:-1] + v[2:]
    return d if axis == 0 else d.T


def _inside_triples(inside: NDArray[np.bool_], axis: int) -> NDArray[np.bool_]:
    v = inside if axis == 0 else inside.T
    t = v[:-2] & v[1:-1] & v[2:]
    return t if axis == 0 else t.T


def _normal_equations(weight: Array, bends: list[Array], x: Array) -> Array:
    """The matrix of the least squares applied to x: weights, and second differences times their transpose."""
    y = weight * x
    for axis, bend in enumerate(bends):
        b = bend * _second(x, axis)
        b, rows = (b, y) if axis == 0 else (b.T, y.T)
        rows[:-2] += b
        rows[1:-1] -= 2 * b
        rows[2:] += b
    return y


def _diagonal(weight: Array, bends: list[Array]) -> Array:
    result = weight.copy()
    for axis, bend in enumerate(bends):
        b, rows = (bend, result) if axis == 0 else (bend.T, result.T)
        rows[:-2] += b
        rows[1:-1] += 4 * b
        rows[2:] += b
    return result


def _solve(weight: Array, bends: list[Array], target: Array, x: Array, steps: int) -> Array:
    """Some steps of conjugate gradients from x, with the diagonal as preconditioner."""
    diagonal = _diagonal(weight, bends)
    inverse = np.where(diagonal > 0, 1 / np.where(diagonal > 0, diagonal, 1), 0)
    residual = weight * target - _normal_equations(weight, bends, x)
    direction = inverse * residual
    product = np.vdot(residual, direction)
    for _ in range(steps):
        moved = _normal_equations(weight, bends, direction)
        curvature = np.vdot(direction, moved)
        if not (product > 0 and curvature > 0):
            break
        x = x + (product / curvature) * direction
        residual = residual - (product / curvature) * moved
        conditioned = inverse * residual
        before, product = product, np.vdot(residual, conditioned)
        direction = conditioned + (product / before) * direction
    return x
