# SPDX-License-Identifier: GPL-3.0-or-later
"""Coordinates on the plane of a wall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class WallFrame:
    """Coordinates of a wall: x to the right as seen from outside, y up, both on its plane; then before the plane.

    Attributes:
        origin: of the coordinates, normalised frame, [3].
        axes: along x, y and the normal, each as long as the unit of the coordinates, rows [3, 3].
    """

    origin: Array
    axes: Array

    def points(self, at: Array) -> Array:
        """Convert coordinates [n, 2] on the plane, or [n, 3], to points of the normalised frame [n, 3]."""
        return np.asarray(self.origin + at @ self.axes[: at.shape[1]])

    def coordinates(self, points: Array) -> Array:
        """Convert points [n, 3], normalised frame, to coordinates [n, 3]."""
        return np.asarray((points - self.origin) @ np.linalg.inv(self.axes))

    @property
    def normal(self) -> Array:
        """The unit normal of the wall, outward, [3]."""
        return np.asarray(self.axes[2] / np.linalg.norm(self.axes[2]))
