# SPDX-License-Identifier: GPL-3.0-or-later
"""Move points onto the planes of a building, and to where these meet: into edges and corners."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mgf_engine.start.options import PlaneOptions
from mgf_engine.start.planes import LinePlanes

_CHUNK = 1 << 16  # points whose distances from all planes are computed at a time, which bounds the memory


def snap_to_planes(
    points: NDArray[np.float64], planes: LinePlanes, near: NDArray[np.float64], options: PlaneOptions
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Project points onto all planes within a distance, onto their intersection where there are several.

    Args:
        points: [N, 3], normalised frame.
        planes: to move them onto.
        near: distance up to which each point moves, [N].
        options: which planes a point may move onto together, and the maximum move.

    Returns:
        The points [N, 3] and which planes each lies on, bool [N, K].
    """
    parts = [
        _snap(points[begin : begin + _CHUNK], planes, near[begin : begin + _CHUNK], options)
        for begin in range(0, max(len(points), 1), _CHUNK)
    ]
    return np.concatenate([moved for moved, _ in parts]), np.concatenate([on for _, on in parts])


def _snap(
    points: NDArray[np.float64], planes: LinePlanes, near: NDArray[np.float64], options: PlaneOptions
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Move points onto planes, as :func:`snap_to_planes`, all at once."""
    distance, out = planes.distances(points), points.copy()
    rows = _planes_to_snap_to(distance, np.abs(distance) < near[:, None], planes.planes[:, :3], options.common_cosine)
    for count in range(1, 4):
        of = np.flatnonzero((rows >= 0).sum(1) == count)
        combinations, which = np.unique(rows[of, :count], axis=0, return_inverse=True)
        if not len(of):
            continue
        solve = np.linalg.pinv(planes.planes[combinations, :3], rcond=options.common_rank)
        move = -np.einsum("nik,nk->ni", solve[which.ravel()], np.take_along_axis(distance[of], rows[of, :count], 1))
        near_enough = np.linalg.norm(move, axis=1) < options.longest_move * near[of]
        out[of[near_enough]] += move[near_enough]
    return out, np.abs(planes.distances(out)) < options.on_plane * near[:, None]


def _planes_to_snap_to(
    distance: NDArray[np.float64], allowed: NDArray[np.bool_], normals: NDArray[np.float64], parallel_cosine: float
) -> NDArray[np.int64]:
    """Choose up to three planes for each point: the nearest first, none nearly parallel to one before it.

    Args:
        distance: of points from planes, [N, K].
        allowed: whether each point may be moved onto each plane, bool [N, K].
        normals: of the planes, [K, 3].
        parallel_cosine: of two normals, from which planes are nearly parallel.

    Returns:
        Numbers of planes, -1 for none, [N, 3].
    """
    result = np.full((len(distance), 3), -1)
    parallel = np.abs(normals @ normals.T) >= parallel_cosine
    left = np.where(allowed, np.abs(distance), np.inf)
    for k in range(3 if left.shape[1] else 0):
        nearest = left.argmin(1)
        found = np.isfinite(left[np.arange(len(left)), nearest])
        result[found, k] = nearest[found]
        left[found] = np.where(parallel[nearest[found]], np.inf, left[found])
    return result
