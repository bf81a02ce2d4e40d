# SPDX-License-Identifier: GPL-3.0-or-later
"""Axis-aligned boxes: of points without a few outliers, padded, the points of a grid, and how far boxes overlap."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Corner = NDArray[np.float64]


def percentile_box(
    points: NDArray[np.floating], percentiles: tuple[float, float], padding: float = 0.0
) -> tuple[Corner, Corner]:
    """Return the low and high corner [D] of the box that most points lie in along each axis.

    Args:
        points: [N, D], at least one.
        percentiles: of the coordinates along each axis, between which the box lies.
        padding: space around it, as a share of its longest side.
    """
    low, high = np.percentile(points, percentiles, axis=0)
    return pad_box(low, high, padding)


def pad_box(low: Corner, high: Corner, padding: float) -> tuple[Corner, Corner]:
    """Return the corners of a box with space on all sides: ``padding`` times its longest side."""
    space = padding * float((high - low).max())
    return low - space, high + space


def grid_points(*axes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the points of a grid [N, D] by their coordinates along each axis, the last of which changes fastest."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(axes))


def box_areas(boxes: NDArray[np.floating]) -> NDArray[np.float64]:
    """Compute the areas [N] of axis-aligned rectangles [N, 4], each (low x, low y, high x, high y)."""
    return np.asarray(np.prod(boxes[:, 2:] - boxes[:, :2], axis=1))


def intersection_areas(one: NDArray[np.floating], other: NDArray[np.floating]) -> NDArray[np.float64]:
    """Compute the area that each rectangle of ``one`` [N, 4] shares with each of ``other`` [M, 4], [N, M]."""
    low = np.maximum(one[:, None, :2], other[None, :, :2])
    high = np.minimum(one[:, None, 2:], other[None, :, 2:])
    return np.asarray(np.prod(np.maximum(high - low, 0), axis=2))


def intersection_over_union(one: NDArray[np.floating], other: NDArray[np.floating]) -> NDArray[np.float64]:
    """Compute the intersection over union of each rectangle of ``one`` [N, 4] with each of ``other`` [M, 4], [N, M]."""
    both = intersection_areas(one, other)
    return np.asarray(both / (box_areas(one)[:, None] + box_areas(other)[None] - both))
