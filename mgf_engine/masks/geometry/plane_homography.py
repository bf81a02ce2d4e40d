# SPDX-License-Identifier: GPL-3.0-or-later
"""Carry one photo onto another through a plane: the homography that the plane induces, and where it stays in frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.geometry.ground_plane import GroundPlane
from mgf_engine.model.scene import View


def homography(view: View, other: View, ground: GroundPlane) -> NDArray[np.float64]:
    """Return the homography [3, 3], pixel indices of ``view`` -> those of ``other``, for what lies on the plane; w > 0
    before the camera."""
    turn = other.rotation @ view.rotation.T
    shift = other.rotation @ (view.centre - other.centre)
    height = float(ground.height(view.centre[None])[0])
    # A ray d of the view meets the plane at d * (height / -(normal . d)).
    matrix = turn * height - np.outer(shift, view.rotation @ ground.normal)
    to_index = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]])  # of the pixel whose centre is there
    own, others = to_index @ view.intrinsics, to_index @ other.intrinsics
    return np.asarray(others @ matrix @ np.linalg.inv(own), np.float64)


def spans_inside(matrix: NDArray[np.float64], view: View, size: tuple[int, int]) -> NDArray[np.int32]:
    """Return pixels of a picture of a size (w, h) that a homography [3, 3] puts inside the frame of a view, before it.

    Along a row all that has to hold is linear in x, so what is inside is one span of it.

    Returns:
        the first and one past the last pixel of each row, [h, 2]; the same or less where there is none.
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
    ends = np.stack([np.ceil(first), np.floor(last) + 1], 1)
    return np.clip(ends, 0, width).astype(np.int32)
