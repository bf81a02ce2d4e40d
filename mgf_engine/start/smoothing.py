# SPDX-License-Identifier: GPL-3.0-or-later
"""Smooth stereo points by robust moving least squares: each moves onto a plane through its neighbours.

Matching in whole steps of disparity scatters points by a pixel or two along their rays. A surface through all of them
is pitted, and rays to those that lie too deep cut through thin parts. Neighbours far from the plane weigh little, so
that reveals and mouldings stay (Fleishman, Cohen-Or and Silva 2005).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mgf_engine.native.library import parallel
from mgf_engine.start.options import PointSmoothingOptions


def smooth_points(
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    pixel: float,
    options: PointSmoothingOptions,
    threads: int = 1,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Move points onto planes through their neighbours (kernel ``mgf_smooth_points``).

    Args:
        points: [N, 3], normalised frame.
        normals: [N, 3], returned as they are if ``options.rounds`` is 0.
        pixel: size of a pixel at the building.
        options: number of rounds, neighbours and their weights.
        threads: number of worker threads.

    Returns:
        The points [N, 3] and the unit normals [N, 3] of those planes, of either sign.
    """
    for _ in range(options.rounds if len(points) else 0):
        near = cKDTree(points).query(points, min(options.neighbours, len(points)), workers=threads)[1]
        near = np.ascontiguousarray(near.reshape(len(points), -1), np.int64)
        moved, normals = np.empty_like(points), np.empty_like(points)
        parallel(
            "mgf_smooth_points", len(points), np.ascontiguousarray(points), near, near.shape[1],
            options.radius * pixel, options.offset * pixel, options.most * pixel, moved, normals,
        )  # fmt: skip
        points = moved
    return points, normals
