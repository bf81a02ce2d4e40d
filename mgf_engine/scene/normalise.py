# SPDX-License-Identifier: GPL-3.0-or-later
"""Normalise the frame of a scene: what the cameras look at near the origin, the median camera 5 units away.

The masks are not known yet, so the centre is a robust one: the median of the sparse points, each counted once per
camera that sees it. All of it is float64, and coordinates are subtracted before anything else happens to them, so
that scenes in map coordinates (millions of metres from their origin) keep their precision.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.model.scene import Similarity

#: Median distance from the cameras to the centre, in units of the normalised frame.
CAMERA_DISTANCE = 5.0


def normalise(points: NDArray[np.float64], seen: NDArray[np.int64], centres: NDArray[np.float64]) -> Similarity:
    """Convert scene frame to normalised frame.

    Args:
        points: [P, 3], scene frame.
        seen: [P], number of cameras that see each point.
        centres: [V, 3] camera centres, scene frame.

    Raises:
        BadInput: all cameras stand where the points are, so that there is no scale.
    """
    centre = np.array([weighted_median(points[:, k], np.maximum(seen, 1)) for k in range(3)])
    distance = float(np.median(np.linalg.norm(centres - centre, axis=1)))
    extent = float(np.abs(centres - centre).max())
    if not np.isfinite(distance) or distance <= 1e-9 * max(1.0, extent, float(np.abs(centre).max())):
        raise BadInput("All cameras stand at the centre of the points; export the COLMAP model again with its poses.")
    scale = CAMERA_DISTANCE / distance
    return Similarity(scale, np.eye(3), -scale * centre)


def normalise_pose(
    rotation: NDArray[np.float64], translation: NDArray[np.float64], to_normalised: Similarity
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the pose ``camera = rotation @ scene + translation`` with the normalised frame in the scene frame's place.

    Depths grow by the similarity's scale; pixels stay what they were.
    """
    origin = to_normalised.invert(np.zeros(3))
    return rotation @ to_normalised.rotation.T, to_normalised.scale * (translation + rotation @ origin)


def weighted_median(values: NDArray[np.float64], weights: NDArray[np.int64]) -> float:
    """Return the smallest value with at least half of the total weight at or below it."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(total, total[-1] / 2)]])


def rotation_of(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation matrix [3, 3] of a quaternion (w, x, y, z) of any length but zero."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
