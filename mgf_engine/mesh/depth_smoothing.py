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

Array = NDArray[np.float32]


@dataclass(frozen=True)
class SmoothingOptions:
    """How depth maps are smoothed; lengths are pixels of parallax in the neighbour that sees the most of it."""

    strength: float = 20.0  # weight of second differences beside a depth of precision 1
    crease: float = 0.15  # px, second difference from which it counts as crease rather than noise
    jump: float = 2.0  # px, second difference of the start from which surfaces are not joined
    rounds: int = 3  # of reweighting
    steps: int = 12  # of conjugate gradients in each


def smooth_depth(
    start: Array, depth: Array, precision: Array, step: Array, options: SmoothingOptions = SmoothingOptions()  # noqa: B008
) -> Array:
    """Depth map with noise smoothed where photos are unsure, float32 [H, W].

    Args:
        start: depth that jumps are judged by, 0 where there is no surface, [H, W].
        depth: matched depth, [H, W].
        precision: inverse variance of each depth in px^-2, 0 where no photo tells it, [H, W].
        step: relative change of the inverse depth that is one pixel of parallax, [H, W].
    """
    shown = (start > 0) & (step > 0)
    if not shown.any():
        return depth
    box = _box(shown)
    inside, scale = shown[box], float(np.median(step[shown] / start[shown]))
    with np.errstate(divide="ignore", invalid="ignore"):
        target = np.where(inside, 1 / depth[box] / scale, 0).astype(np.float64)
        first = np.where(inside, 1 / start[box] / scale, 0).astype(np.float64)
    weight = np.where(inside, np.maximum(precision[box], 1e-3), 0.0)
    joined = [_triples(inside, axis) & (np.abs(_second(first, axis)) < options.jump) for axis in (0, 1)]
    found = target
    for _ in range(options.rounds):
        bend = [
            options.strength * j / np.sqrt(1 + (_second(found, axis) / options.crease) ** 2)
            for axis, j in enumerate(joined)
        ]
        found = _solve(weight, bend, target, found, options.steps)
    result = depth.copy()
    result[box] = np.where(inside, 1 / np.maximum(found * scale, 1e-12), depth[box])
    return result


def _box(shown: NDArray[np.bool_]) -> tuple[slice, slice]:
    rows, columns = np.flatnonzero(shown.any(1)), np.flatnonzero(shown.any(0))
    return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)


def _second(values: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Second differences along an axis, [H - 2, W] or [H, W - 2]."""
    v = values if axis == 0 else values.T
    d = v[:-2] - 2 * v[1:-1] + v[2:]
    return d if axis == 0 else d.T


def _triples(inside: NDArray[np.bool_], axis: int) -> NDArray[np.bool_]:
    v = inside if axis == 0 else inside.T
    t = v[:-2] & v[1:-1] & v[2:]
    return t if axis == 0 else t.T


def _spread(bend: NDArray[np.float64], axis: int, out: NDArray[np.float64]) -> None:
    """Add the transpose of the second differences of ``bend`` to ``out``."""
    b, o = (bend, out) if axis == 0 else (bend.T, out.T)
    o[:-2] += b
    o[1:-1] -= 2 * b
    o[2:] += b


def _apply(weight: NDArray[np.float64], bend: list[NDArray[np.float64]], x: NDArray[np.float64]) -> NDArray[np.float64]:
    y = weight * x
    for axis, b in enumerate(bend):
        _spread(b * _second(x, axis), axis, y)
    return y


def _solve(
    weight: NDArray[np.float64], bend: list[NDArray[np.float64]], target: NDArray[np.float64],
    x: NDArray[np.float64], steps: int,
) -> NDArray[np.float64]:  # fmt: skip
    """Conjugate gradients with the diagonal as preconditioner."""
    diagonal = weight.copy()
    for axis, b in enumerate(bend):
        d, c = (diagonal, b) if axis == 0 else (diagonal.T, b.T)
        d[:-2] += c
        d[1:-1] += 4 * c
        d[2:] += c
    inverse = np.where(diagonal > 0, 1 / np.maximum(diagonal, 1e-12), 0)
    residual = weight * target - _apply(weight, bend, x)
    z = inverse * residual
    direction, product = z, float((residual * z).sum())
    for _ in range(steps):
        if product <= 0:
            break
        moved = _apply(weight, bend, direction)
        length = product / max(float((direction * moved).sum()), 1e-30)
        x = x + length * direction
        residual = residual - length * moved
        z = inverse * residual
        new = float((residual * z).sum())
        direction, product = z + (new / product) * direction, new
    return x
