# SPDX-License-Identifier: GPL-3.0-or-later
"""Axis-aligned bounding boxes that ignore a few outliers."""

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
