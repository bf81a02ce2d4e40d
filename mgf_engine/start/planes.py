# SPDX-License-Identifier: GPL-3.0-or-later
"""Planes through the lines of a building, and points on them to which Delaunay tetrahedra conform."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError, cKDTree

from mgf_engine.start.lines import Line
from mgf_engine.start.options import PlaneOptions

_PARALLEL_COSINE = 0.97  # planes that hardly meet have no common place
_MEETING_RCOND = 0.05  # singular values below this share of the largest do not move a point


@dataclass(frozen=True)
class LinePlanes:
    """Planes through lines, [K, 4] (unit normal, offset), strongest first.

    Attributes:
        members: of each plane the numbers of its lines.
        strength: px of lines they carry, counted as far as these run in two directions, [K].
    """

    planes: NDArray[np.float64]
    members: list[NDArray[np.int64]]
    strength: NDArray[np.float64]

    def distances(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Signed distances [N, K]."""
        return np.asarray(points @ self.planes[:, :3].T + self.planes[:, 3])


def dominant_directions(
    directions: NDArray[np.float64], lengths: NDArray[np.float64], o: PlaneOptions
) -> NDArray[np.float64]:
    """Directions [M, 3] that most of the lines (unit [N, 3], lengths [N]) follow, most length first."""
    left = lengths.copy()
    found: list[NDArray[np.float64]] = []
    limit = np.cos(np.radians(o.direction_angle))
    while len(found) < o.directions:
        votes = (np.abs(directions @ directions.T) > limit) @ left
        best = int(votes.argmax()) if len(votes) else 0
        if not len(votes) or votes[best] < o.direction_share * lengths.sum():
            break
        d = directions[best]
        for _ in range(5):
            cosine = directions @ d
            near = np.abs(cosine) > limit
            d = (directions[near] * (np.sign(cosine[near]) * left[near])[:, None]).sum(0)
            d = d / max(float(np.linalg.norm(d)), 1e-30)
        found.append(d)
        left[near] = 0
    return np.array(found).reshape(-1, 3)


def find_planes(lines: Sequence[Line], pixel: float, o: PlaneOptions) -> LinePlanes:
    """Planes that carry lines, each taken for the length of line that no earlier one explains.

    Candidates are pairs of dominant directions at each line parallel to both, and pairs of lines that lie in one plane.
    """
    if len(lines) < 2:
        return LinePlanes(np.zeros((0, 4)), [], np.zeros(0))
    a, b = np.stack([line.ends[0] for line in lines]), np.stack([line.ends[1] for line in lines])
    d, length = _unit(b - a), np.linalg.norm(b - a, axis=1)
    regular, pairs = _regular(a, b, d, length, o), _pairs(a, b, d, length, pixel, o)
    normal, offset = np.concatenate([regular[:, :3], pairs[:, :3]]), np.r_[regular[:, 3], pairs[:, 3]]
    factor = np.r_[np.full(len(regular), o.regular_weight), np.ones(len(pairs))]
    inlier = _within(normal, offset, a, b, o.near * pixel).astype(np.float32)
    weight = np.minimum(length / pixel, o.longest)
    turned = np.abs(d @ d.T) < np.cos(np.radians(o.crossing))
    across = inlier * turned[np.where(inlier > 0, weight, 0).argmax(1)]
    taken, alive = np.zeros(len(lines)), np.ones(len(normal), bool)
    planes: list[NDArray[np.float64]] = []
    members: list[NDArray[np.int64]] = []
    strength: list[float] = []
    while len(planes) < o.most and alive.any():
        w = (weight * np.select([taken == 0, taken == 1], [1.0, 0.7], 0.1)).astype(np.float32)
        whole, other = inlier @ w, across @ w  # what runs another way than the longest line must hold its own
        gain = factor * np.minimum(whole, 3 * other + np.where(factor > 1, 0.5 * whole, 0)) * alive
        best = int(gain.argmax())
        if gain[best] < o.least:
            break
        alive[best] = False
        plane, mine = _fitted(np.r_[normal[best], offset[best]], inlier[best] > 0, a, b, length, factor[best] > 1)
        mine = np.flatnonzero(_within(plane[None, :3], plane[3:], a, b, o.near * pixel)[0])
        if len(mine) < (2 if factor[best] > 1 else 3):
            continue
        alive &= ~_same(normal, offset, plane, pixel, o)
        if planes and _same(np.stack(planes)[:, :3], np.stack(planes)[:, 3], plane, pixel, o).any():
            continue
        planes.append(plane)
        members.append(mine)
        taken[mine] += 1
        crossing = turned[mine[weight[mine].argmax()]][mine]
        strength.append(min(weight[mine].sum(), 3 * weight[mine][crossing].sum() + 0.2 * weight[mine].sum()))
    return LinePlanes(np.array(planes).reshape(-1, 4), members, np.array(strength))


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-30))


def _within(
    normal: NDArray[np.float64],
    offset: NDArray[np.float64],
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    near: float,
) -> NDArray[np.bool_]:
    """Find which lines lie in which planes, bool [K, N]."""
    return np.asarray(np.all([np.abs(normal @ p.T + offset[:, None]) < near for p in (a, b)], axis=0))


def _same(
    normal: NDArray[np.float64],
    offset: NDArray[np.float64],
    plane: NDArray[np.float64],
    pixel: float,
    o: PlaneOptions,
) -> NDArray[np.bool_]:
    cosine = normal @ plane[:3]
    near = np.abs(offset * np.sign(cosine) - plane[3]) < o.same_distance * pixel
    return np.asarray((np.abs(cosine) > o.same_cosine) & near)


def _regular(
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    d: NDArray[np.float64],
    length: NDArray[np.float64],
    o: PlaneOptions,
) -> NDArray[np.float64]:
    """Candidates [C, 4] along two dominant directions, through each line that is parallel to both."""
    main, middle = dominant_directions(d, length, o), (a + b) / 2
    found = [np.zeros((0, 4))]
    for i in range(len(main)):
        for j in range(i):
            normal = np.cross(main[i], main[j])
            if np.linalg.norm(normal) < 0.5:
                continue
            normal = normal / np.linalg.norm(normal)
            rows = np.abs(d @ normal) < np.sin(np.radians(o.along))
            found.append(np.c_[np.broadcast_to(normal, (rows.sum(), 3)), -(middle[rows] @ normal)])
    return np.concatenate(found)


def _pairs(
    a: NDArray[np.float64], b: NDArray[np.float64], d: NDArray[np.float64], length: NDArray[np.float64], pixel: float,
    o: PlaneOptions,
) -> NDArray[np.float64]:  # fmt: skip
    """Candidates [C, 4] through two lines that cross or run side by side, those of long lines first."""
    strong = np.argsort(-length, kind="stable")[:1500]  # pairs are quadratic in memory
    i, j = (strong[k] for k in np.triu_indices(len(strong), 1))
    middle = (a + b) / 2
    cosine = np.abs((d[i] * d[j]).sum(1))
    beside = cosine > np.cos(np.radians(o.parallel))
    keep = beside | (cosine < np.cos(np.radians(o.crossing)))
    i, j, beside = i[keep], j[keep], beside[keep]
    across = middle[j] - middle[i]
    across -= (across * d[i]).sum(1)[:, None] * d[i]
    normal = np.where(beside[:, None], np.cross(d[i], across), np.cross(d[i], d[j]))
    size = np.linalg.norm(normal, axis=1)
    usable = (size > 1e-9) & (~beside | (np.linalg.norm(across, axis=1) > 5 * pixel))
    i, j, normal = i[usable], j[usable], normal[usable] / size[usable, None]
    offset = -(normal * (middle[i] + middle[j]) / 2).sum(1)
    reach = [np.abs((normal * p).sum(1) + offset) for p in (a[i], a[j])]
    touch = np.flatnonzero(np.maximum(*reach) < o.near * pixel)
    touch = touch[np.argsort(-np.minimum(length[i[touch]], length[j[touch]]), kind="stable")[: o.candidates]]
    return np.c_[normal[touch], offset[touch]]


def _fitted(
    plane: NDArray[np.float64], mine: NDArray[np.bool_], a: NDArray[np.float64], b: NDArray[np.float64],
    length: NDArray[np.float64], regular: bool,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:  # fmt: skip
    """The plane through its lines; a regular one keeps its direction."""
    rows = np.flatnonzero(mine)
    if regular:
        middle = np.average((a[rows] + b[rows]) / 2, axis=0, weights=length[rows])
        return np.r_[plane[:3], -plane[:3] @ middle], rows
    if len(rows) < 3:
        return plane, rows
    points, weight = np.concatenate([a[rows], b[rows]]), np.r_[length[rows], length[rows]]
    centre = np.average(points, axis=0, weights=weight)
    normal = np.linalg.svd((points - centre) * np.sqrt(weight)[:, None], full_matrices=False)[2][2]
    return np.r_[normal, -normal @ centre], rows


def snap(
    points: NDArray[np.float64], planes: LinePlanes, near: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Points [N, 3] moved onto all planes within ``near`` [N], to their common point where there are several.

    Returns:
        The points and which planes each lies on, bool [N, K].
    """
    distance, out = planes.distances(points), points.copy()
    rows = _meeting(distance, np.abs(distance) < near[:, None], planes.planes[:, :3])
    for count in range(1, 4):
        of = np.flatnonzero((rows >= 0).sum(1) == count)
        combinations, which = np.unique(rows[of, :count], axis=0, return_inverse=True)
        if not len(of):
            continue
        solve = np.linalg.pinv(planes.planes[combinations, :3], rcond=_MEETING_RCOND)
        move = -np.einsum("nik,nk->ni", solve[which.ravel()], np.take_along_axis(distance[of], rows[of, :count], 1))
        near_enough = np.linalg.norm(move, axis=1) < 2 * near[of]
        out[of[near_enough]] += move[near_enough]
    return out, np.abs(planes.distances(out)) < 0.1 * near[:, None]


def _meeting(distance: NDArray[np.float64], on: NDArray[np.bool_], normals: NDArray[np.float64]) -> NDArray[np.int64]:
    """Up to three planes that each point is moved onto: the nearest first, none nearly parallel to one before it.

    Args:
        distance: of points from planes, [N, K].
        on: whether each point may be moved onto each plane, bool [N, K].
        normals: of the planes, [K, 3].

    Returns:
        Numbers of planes, -1 for none, [N, 3].
    """
    result = np.full((len(distance), 3), -1)
    parallel = np.abs(normals @ normals.T) >= _PARALLEL_COSINE
    left = np.where(on, np.abs(distance), np.inf)
    for k in range(3 if left.shape[1] else 0):
        nearest = left.argmin(1)
        found = np.isfinite(left[np.arange(len(left)), nearest])
        result[found, k] = nearest[found]
        left[found] = np.where(parallel[nearest[found]], np.inf, left[found])
    return result


def plane_points(
    planes: LinePlanes, lines: Sequence[Line], dense: NDArray[np.float64], pixel: float, o: PlaneOptions
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Points every ``o.grid`` px on each plane over the convex hull of its lines [N, 3], and the plane of each.

    A plane just beside a stronger parallel one (a pane, a frame) has points near its own lines only, since nothing else
    tells which of the two a bare stretch lies on. Where dense points [M, 3] lie beside the plane there are none.
    """
    found, owner = [np.zeros((0, 3))], [np.zeros(0, np.int64)]
    tree = cKDTree(dense) if len(dense) else None
    for k, plane in enumerate(planes.planes):
        ends = np.stack([lines[n].ends for n in planes.members[k]])
        along, down = _axes(plane[:3], ends[0, 1] - ends[0, 0])
        uv = np.concatenate([np.linspace(p, q, 2 + int(np.linalg.norm(q - p) / (4 * pixel))) for p, q in ends])
        uv = np.stack([uv @ along, uv @ down], 1)
        flat = _grid(uv, o.grid * pixel, o.reach * pixel)
        cosine = planes.planes[:, :3] @ plane[:3]
        beside = np.abs(planes.planes[:, 3] * np.sign(cosine) - plane[3]) < o.layer * pixel
        if (beside & (np.abs(cosine) > 0.995) & (planes.strength > planes.strength[k])).any() and len(flat):
            flat = flat[cKDTree(uv).query(flat)[0] < o.reach * pixel]
        points = flat[:, :1] * along + flat[:, 1:] * down - plane[3] * plane[:3]
        if tree is not None and len(points):
            points = points[~_contradicted(points, plane, dense, tree, pixel, o)]
        found.append(points)
        owner.append(np.full(len(points), k))
    return np.concatenate(found), np.concatenate(owner)


def _contradicted(
    points: NDArray[np.float64],
    plane: NDArray[np.float64],
    dense: NDArray[np.float64],
    tree: cKDTree,
    pixel: float,
    o: PlaneOptions,
) -> NDArray[np.bool_]:
    """Points of a plane around which dense points lie beside it: on a vault, chords are no planes."""
    result = np.zeros(len(points), bool)
    for n, near in enumerate(tree.query_ball_point(points, o.contradiction_radius * pixel)):
        if len(near) >= o.contradiction_points:
            result[n] = np.median(np.abs(dense[near] @ plane[:3] + plane[3])) > o.contradiction_distance * pixel
    return result


def _axes(normal: NDArray[np.float64], towards: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    along = towards - (towards @ normal) * normal
    along = along / np.linalg.norm(along)
    return along, np.cross(normal, along)


def _grid(uv: NDArray[np.float64], step: float, reach: float) -> NDArray[np.float64]:
    """Points [N, 2] of a grid over the convex hull of ``uv``, grown by ``reach``."""
    low, high = uv.min(0) - reach, uv.max(0) + reach
    axes = [np.arange(a, b, step) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)
    try:
        hull = ConvexHull(uv)
    except QhullError:  # all lines on one
        return np.zeros((0, 2))
    return np.asarray(grid[(grid @ hull.equations[:, :2].T + hull.equations[:, 2]).max(1) < reach])


def crease_points(
    planes: LinePlanes, points: NDArray[np.float64], owner: NDArray[np.int64], step: float, reach: float
) -> NDArray[np.float64]:
    """Points every ``step`` where two planes meet and both have points of their own within ``reach``, [N, 3]."""
    if not len(points):
        return np.zeros((0, 3))
    trees = [cKDTree(points[owner == k]) if (owner == k).any() else None for k in range(len(planes.planes))]
    low, high, found = points.min(0) - reach, points.max(0) + reach, [np.zeros((0, 3))]
    span = np.arange(-0.5, 0.5, step / np.linalg.norm(high - low)) * np.linalg.norm(high - low)
    for i, first in enumerate(planes.planes):
        for j in range(i):
            second, one, other = planes.planes[j], trees[i], trees[j]
            d = np.cross(first[:3], second[:3])
            if np.linalg.norm(d) < 0.25 or one is None or other is None:
                continue
            d = d / np.linalg.norm(d)
            rows = np.stack([first[:3], second[:3], d])
            at = np.linalg.solve(rows, np.r_[-first[3], -second[3], d @ (low + high) / 2]) + span[:, None] * d
            at = at[((at > low) & (at < high)).all(1)]
            if len(at):
                found.append(at[(one.query(at)[0] < reach) & (other.query(at)[0] < reach)])
    return np.concatenate(found)
