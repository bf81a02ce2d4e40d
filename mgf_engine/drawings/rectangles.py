# SPDX-License-Identifier: GPL-3.0-or-later
"""Level rectangles in place of the frayed outlines of openings and bays in a wall."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.drawings.model import Array
from mgf_engine.drawings.straighten import FittedSegment, Stroke
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class RectangleOptions:
    """Options of the rectangles that outlines within a wall are drawn as."""

    overlap: float = parameter(
        0.85, "Overlap (intersection over union) with its rectangle from which an outline is drawn as one", high=1
    )


def fit_rectangle(corners: Array, options: RectangleOptions = RectangleOptions()) -> Array | None:
    """Fit an upright rectangle to a closed border: left, top, right, bottom in pixels [4]; None for what is none.

    Each edge lies at the median of where the rows or columns of the area within the border begin and end.

    Args:
        corners: [n, 2], columns and rows of pixel corners in order, the first again at the end.
        options: how much of a rectangle it has to be.
    """
    low = np.floor(corners.min(0))
    size = np.ceil(corners.max(0) - low).astype(int)
    canvas = np.zeros((2 * size[1] + 1, 2 * size[0] + 1), np.uint8)
    cv2.fillPoly(canvas, [np.rint(2 * (corners - low)).astype(np.int32)], 1)
    filled = canvas[1::2, 1::2] > 0  # middles of pixels; borders lie between them
    if not filled.any():
        return None
    high = np.flatnonzero(filled.sum(1) > 0.5 * filled.sum(1).max())
    wide = np.flatnonzero(filled.sum(0) > 0.5 * filled.sum(0).max())
    left, right = _ends(filled[high[0] : high[-1] + 1])
    top, bottom = _ends(filled[:, wide[0] : wide[-1] + 1].T)
    y, x = np.nonzero(filled)
    both = float(((x + 0.5 > left) & (x + 0.5 < right) & (y + 0.5 > top) & (y + 0.5 < bottom)).sum())
    if both < options.overlap * ((right - left) * (bottom - top) + float(filled.sum()) - both):
        return None
    return np.array([left, top, right, bottom]) + np.tile(low, 2)


def rectangle_stroke(ring: Array, ends: tuple[int, int]) -> Stroke:
    """Return a rectangle [4, 2], level and upright, as a closed stroke."""
    points = np.concatenate([ring, ring[:1]])
    segments = []
    for k in range(4):
        span = points[k + 1] - points[k]
        along = np.where(np.abs(span) == np.abs(span).max(), np.sign(span), 0.0)
        segments.append(FittedSegment(0.5 * (points[k] + points[k + 1]), along, float(np.abs(span).max())))
    return Stroke(segments, points, ends)


def _ends(rows: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the medians of where rows of a mask [n, W] begin and end."""
    some = rows[rows.any(1)]
    return float(np.median(some.argmax(1))), float(np.median(rows.shape[1] - some[:, ::-1].argmax(1)))
