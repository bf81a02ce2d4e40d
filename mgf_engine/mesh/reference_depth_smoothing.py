# SPDX-License-Identifier: GPL-3.0-or-later
"""Plain float64 reference of ``csrc/stereo/smooth_depth.c``: robust second-order smoothing of a map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def smooth_map(
    weight: Array,
    target: Array,
    joined: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    strength: float,
    crease: float,
    rounds: int,
    steps: int,
) -> Array:
    """Smooth a map by iteratively reweighted least squares.

    Args:
        weight: of the data term, [H, W]; 0 where nothing is known.
        target: the map, [H, W].
        joined: whether three values in a column [H-2, W], and in a row [H, W-2], belong to one surface.
        strength: weight of the squared second differences beside the data term's.
        crease: second difference from which it counts as a crease.
        rounds: of reweighting.
        steps: of conjugate gradients in each round.
    """
    found = target
    for _ in range(rounds):
        bends = [
            np.where(j, strength / np.sqrt(1 + (second_difference(found, axis) / crease) ** 2), 0)
            for axis, j in enumerate(joined)
        ]
        found = _solve(weight, bends, target, found, steps)
    return found


def second_difference(values: Array, axis: int) -> Array:
    """Compute second differences along an axis, which becomes shorter by two."""
    v = values if axis == 0 else values.T
    d = v[:-2] - 2 * v[1:-1] + v[2:]
    return d if axis == 0 else d.T


def _normal_equations(weight: Array, bends: list[Array], x: Array) -> Array:
    """Return the matrix of the least squares applied to x: weights, and second differences times their transpose."""
    y = weight * x
    for axis, bend in enumerate(bends):
        b = bend * second_difference(x, axis)
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
    """Take some steps of conjugate gradients from x, with the diagonal as preconditioner."""
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
