# SPDX-License-Identifier: GPL-3.0-or-later
"""Place points on planes, and on the creases between them, to which Delaunay tetrahedra conform."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError, cKDTree

from mgf_engine.geometry.boxes import grid_points
from mgf_engine.start.lines import Line3D
from mgf_engine.start.options import PlaneOptions
from mgf_engine.start.planes import LinePlanes, parallel_beside


def plane_points(
    planes: LinePlanes, lines: Sequence[Line3D], dense: NDArray[np.float64], pixel: float, options: PlaneOptions
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Place points every ``options.grid`` px on each plane, over the rectangle around its lines or their convex hull.

    The rectangle is filled if lines run along both of its sides and no stronger parallel plane is near, else the hull.
    A plane just beside a stronger parallel one (a pane, a frame) gets points near its own lines only: a bare area
    between them may lie on either plane. No points are placed where stereo points contradict the plane.

    Args:
        planes: to place points on.
        lines: all lines, which the planes' members number.
        dense: points by stereo, [M, 3].
        pixel: size of a pixel at the building.
        options: distances in pixels.

    Returns:
        points [N, 3] and the plane of each [N].
    """
    found, owner = [np.zeros((0, 3))], [np.zeros(0, np.int64)]
    tree = cKDTree(dense) if len(dense) else None
    for k, plane in enumerate(planes.planes):
        ends = np.stack([lines[n].ends for n in planes.members[k]])
        axes = _axes(plane[:3], ends)
        ends = ends @ axes.T
        uv = np.concatenate([np.linspace(p, q, 2 + int(np.linalg.norm(q - p) / (4 * pixel))) for p, q in ends])
        grid = _grid(uv, options.grid * pixel, options.reach * pixel)
        if not _spans_rectangle(ends, options) or _beside_stronger(planes, k, options.rectangle_layer * pixel, options):
            grid = grid[_in_hull(grid, uv, options.reach * pixel)]
        if len(grid) and _beside_stronger(planes, k, options.layer * pixel, options):
            grid = grid[cKDTree(uv).query(grid)[0] < options.reach * pixel]
        points = grid @ axes - plane[3] * plane[:3]
        if tree is not None and len(points):
            points = points[~_contradicted(points, plane, tree, pixel, options)]
        found.append(points)
        owner.append(np.full(len(points), k))
    return np.concatenate(found), np.concatenate(owner)


def _beside_stronger(planes: LinePlanes, number: int, distance: float, options: PlaneOptions) -> bool:
    """Tell whether a stronger parallel plane lies just beside a plane."""
    beside = parallel_beside(planes.planes, planes.planes[number], options.layer_cosine, distance)
    return bool((beside & (planes.strength > planes.strength[number])).any())


def _contradicted(
    points: NDArray[np.float64], plane: NDArray[np.float64], tree: cKDTree, pixel: float, options: PlaneOptions
) -> NDArray[np.bool_]:
    """Tell which points [N, 3] of a plane the stereo points around them contradict, bool [N].

    This finds planes through lines on a vault, which are chords of it.

    Args:
        points: on the plane, normalised frame.
        plane: unit normal and offset, [4].
        tree: of the stereo points.
        pixel: size of a pixel at the building.
        options: radius, number and median distance of the stereo points that contradict.
    """
    near = tree.query_ball_point(points, options.contradiction_radius * pixel)
    count = np.array([len(numbers) for numbers in near])
    count[count < max(options.contradiction_points, 1)] = 0
    rows = np.flatnonzero(count)
    held = np.fromiter(chain.from_iterable(near[rows]), np.int64, int(count.sum()))
    distance = np.abs(tree.data[held] @ plane[:3] + plane[3])
    distance = distance[np.lexsort((distance, np.repeat(rows, count[rows])))]  # of each point apart, ascending
    first = np.cumsum(count[rows]) - count[rows]
    median = (distance[first + (count[rows] - 1) // 2] + distance[first + count[rows] // 2]) / 2
    result = np.zeros(len(points), bool)
    result[rows] = median > options.contradiction_distance * pixel
    return result


def _axes(normal: NDArray[np.float64], ends: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return two orthogonal unit vectors of a plane, [2, 3], along most of the length of its lines.

    Args:
        normal: of the plane, [3].
        ends: of lines on it, [L, 2, 3].
    """
    along = np.linalg.svd(normal[None])[2][1]
    across = np.cross(normal, along)
    run = (ends[:, 1] - ends[:, 0]) @ np.stack([along, across], 1) @ (1, 1j)
    turn = np.angle((run**4 / np.maximum(np.abs(run), 1e-12) ** 3).sum()) / 4  # the same for a quarter turn
    along = np.cos(turn) * along + np.sin(turn) * across
    return np.stack([along, np.cross(normal, along)])


def _grid(uv: NDArray[np.float64], step: float, reach: float) -> NDArray[np.float64]:
    """Return points [N, 2] of a grid over the rectangle around ``uv`` [M, 2], grown by ``reach``."""
    low, high = uv.min(0) - reach, uv.max(0) + reach
    axes = [np.arange(a, b, step) for a, b in zip(low, high, strict=True)]
    return grid_points(*axes)


def _spans_rectangle(ends: NDArray[np.float64], options: PlaneOptions) -> bool:
    """Tell whether lines [L, 2, 2] run along both axes, as the foot and a corner of a wall do.

    Lines along one axis only may be chords of a vault.
    """
    run = np.abs(ends[:, 1] - ends[:, 0])
    length = np.linalg.norm(run, axis=1)
    along = (length[:, None] * (run[:, ::-1] < np.sin(np.deg2rad(options.parallel)) * length[:, None])).sum(0)
    return bool(along.min() >= options.rectangle_share * length.sum())


def _in_hull(points: NDArray[np.float64], uv: NDArray[np.float64], reach: float) -> NDArray[np.bool_]:
    """Tell which points [N, 2] lie in the convex hull of ``uv`` [M, 2], grown by ``reach``; none where it is a line."""
    try:
        hull = ConvexHull(uv)
    except QhullError:
        return np.zeros(len(points), bool)
    return np.asarray((points @ hull.equations[:, :2].T + hull.equations[:, 2]).max(1) < reach)


def crease_points(
    planes: LinePlanes, points: NDArray[np.float64], owner: NDArray[np.int64], pixel: float, options: PlaneOptions
) -> NDArray[np.float64]:
    """Place points every ``options.crease`` px where two planes meet and both have points of their own near by.

    Args:
        planes: that meet.
        points: on the planes, [N, 3].
        owner: plane of each point, [N].
        pixel: size of a pixel at the building.
        options: distances in pixels.

    Returns:
        points [M, 3].
    """
    if not len(points):
        return np.zeros((0, 3))
    step, reach = options.crease * pixel, options.crease_reach * options.grid * pixel
    trees = [cKDTree(points[owner == k]) if (owner == k).any() else None for k in range(len(planes.planes))]
    low, high, found = points.min(0) - reach, points.max(0) + reach, [np.zeros((0, 3))]
    span = np.arange(-0.5, 0.5, step / np.linalg.norm(high - low)) * np.linalg.norm(high - low)
    for i, first in enumerate(planes.planes):
        for j, d in enumerate(np.cross(first[:3], planes.planes[:i, :3])):
            second, one, other = planes.planes[j], trees[i], trees[j]
            if np.linalg.norm(d) < options.crease_sine or one is None or other is None:
                continue
            d = d / np.linalg.norm(d)
            rows = np.stack([first[:3], second[:3], d])
            at = np.linalg.solve(rows, np.r_[-first[3], -second[3], d @ (low + high) / 2]) + span[:, None] * d
            at = at[((at > low) & (at < high)).all(1)]
            if len(at):
                found.append(at[(one.query(at)[0] < reach) & (other.query(at)[0] < reach)])
    return np.concatenate(found)
