# SPDX-License-Identifier: GPL-3.0-or-later
"""Roofs that lie in no plane, such as the cone of a round tower or a dome: replaced by a pyramid of up to four planes.

A large part of the ground plan that no roof plane explains would otherwise be given to the plane of a neighbour, and a
tower be cut off at the roof of its nave.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.drawings.model import Array
from mgf_engine.drawings.project import Grid
from mgf_engine.models.solid.evidence_options import EvidenceOptions

SIDES = 4  # of a pyramid


def add_round_roofs(
    label: NDArray[np.int32],
    slopes: Array,
    height: Array,
    inside: NDArray[np.bool_],
    grid: Grid,
    detail: float,
    turn: float,
    options: EvidenceOptions = EvidenceOptions(),
) -> Array:
    """Fit planes to large parts of the ground plan that lie in no roof plane; return all slopes.

    Args:
        label: of each pixel, row of ``slopes`` + 1, 0 for none [H, W]; pixels of new planes are given theirs.
        slopes: [P, 3], roof planes ``z = a x + b y + c``.
        height: from above, NaN where nothing is seen [H, W].
        inside: where the building stands [H, W].
        grid: of the ground plan.
        detail: smallest size that is modelled.
        turn: direction that a side of a pyramid faces, radians counter-clockwise from the x axis.
        options: least area of a part, and angles.
    """
    left, seen = (label == 0) & inside, np.isfinite(height)
    wide = max(1, round(options.round_opening * detail / grid.resolution))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * wide + 1, 2 * wide + 1))
    whole = cv2.morphologyEx(left.astype(np.uint8), cv2.MORPH_CLOSE, kernel) * inside.astype(np.uint8)
    core = cv2.morphologyEx(whole, cv2.MORPH_OPEN, kernel)
    _, part, stats, _ = cv2.connectedComponentsWithStats(core, connectivity=4)
    least = options.round_least * (detail / grid.resolution) ** 2
    found = list(slopes)
    for k in np.flatnonzero(stats[:, cv2.CC_STAT_AREA] >= least):
        if k == 0:
            continue
        row, column = np.nonzero((part == k) & seen)
        if len(row) < 0.5 * stats[k, cv2.CC_STAT_AREA]:
            continue
        at = grid.places(np.stack([column, row], 1).astype(np.float64) + 0.5)
        planes = _pyramid(at, height[row, column], _gradient(height, row, column, grid, wide), turn, options)
        off = np.abs(at @ planes[:, :2].T + planes[:, 2] - height[row, column][:, None])
        label[row, column] = len(found) + 1 + off.argmin(1)
        found += list(planes)
    return np.array(found).reshape(-1, 3)


def _gradient(height: Array, row: NDArray[np.int64], column: NDArray[np.int64], grid: Grid, wide: int) -> Array:
    """Return slopes along x and y of the blurred heights of some pixels, [n, 2]."""
    known = np.isfinite(height)
    size = (2 * wide + 1, 2 * wide + 1)
    weight = cv2.blur(known.astype(np.float64), size)
    mean = cv2.blur(np.where(known, height, 0.0), size) / np.maximum(weight, 1e-9)
    right = np.asarray(np.gradient(mean, grid.resolution, axis=1))
    down = np.asarray(np.gradient(mean, grid.resolution, axis=0))
    return np.stack([right[row, column], -down[row, column]], 1)


def _pyramid(at: Array, height: Array, gradient: Array, turn: float, options: EvidenceOptions) -> Array:
    """Fit a plane of least squares to each quarter that a roof falls towards, or one level plane, [n, 3]."""
    level = np.array([[0.0, 0.0, float(np.median(height))]])
    steep = np.linalg.norm(gradient, axis=1)
    if np.median(steep) < np.tan(np.radians(options.round_level)):
        return level
    falls = np.arctan2(-gradient[:, 1], -gradient[:, 0]) - turn
    side = np.round(falls / (2 * np.pi / SIDES)).astype(np.int64) % SIDES
    planes = []
    for k in range(SIDES):
        own = side == k
        if own.mean() < options.round_side:
            continue
        terms = np.column_stack([at[own], np.ones(int(own.sum()))])
        plane = np.linalg.lstsq(terms, height[own], rcond=None)[0]
        if np.hypot(*plane[:2]) < np.tan(np.radians(options.largest_tilt)):
            planes.append(plane)
    return np.array(planes) if planes else level
