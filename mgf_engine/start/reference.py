# SPDX-License-Identifier: GPL-3.0-or-later
"""References of the kernels of the starting surface: float64, one item at a time, for tests."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from mgf_engine.start.options import OutsideOptions, PlaneOptions
from mgf_engine.start.segments import Segments
from mgf_engine.start.tetrahedra import FACE_CORNERS, Tetrahedra
from mgf_engine.start.views import Silhouettes

Array = NDArray[np.float64]


def _projected(p: Array, x: Array) -> Array | None:
    """Project a point [3] to pixels [2] by a matrix [3, 4]; None behind the camera."""
    w = p[2, :3] @ x + p[2, 3]
    return None if w <= 0 else (p[:2, :3] @ x + p[:2, 3]) / w


def _image_line(segments: Segments, view: int, line: Array) -> tuple[Array, Array, float] | None:
    """Project a line [2, 3]: start, unit direction and length in pixels; None below 4 px or behind the camera."""
    a, b = (_projected(segments.views.silhouettes.projections[view], x) for x in line)
    if a is None or b is None or np.linalg.norm(b - a) < 4:
        return None
    length = float(np.linalg.norm(b - a))
    return a, (b - a) / length, length


def support(segments: Segments, m: int, line: Array, reach: float) -> float:
    """Compute how far segment ``m`` covers a line [2, 3] in its photo, 0..1.

    Args:
        segments: of all photos.
        m: row of the segment.
        line: two points on it, normalised frame, [2, 3].
        reach: px, distance within which it covers the line.
    """
    found = _image_line(segments, int(segments.view[m]), line)
    if found is None:
        return 0.0
    a, d, length = found
    ends = segments.ends[m].reshape(2, 2) - a
    off, along = np.abs(ends[:, 0] * d[1] - ends[:, 1] * d[0]), ends @ d
    over = min(along[1], length) - max(along[0], 0.0)
    if (off > reach).any() or along[1] <= along[0] or over < segments.options.overlap * length:
        return 0.0
    return float(np.exp(-2 * off.mean() ** 2 / reach**2) * min(1.0, over / length))


def same_color(segments: Segments, n: int, m: int) -> bool:
    """Tell whether at least one side of two segments has the same colour."""
    off = (segments.sides[n].astype(float) - segments.sides[m]) / np.array([3.0, 1, 1])
    return bool(((off**2).sum(1) < segments.options.color**2).any())


def best_segment(segments: Segments, view: int, line: Array, n: int) -> tuple[int, float]:
    """Find the segment of a photo that fits a line of segment ``n`` best, and its score; -1, 0 for none.

    Args:
        segments: of all photos.
        view: number of the photo.
        line: two points on it, normalised frame, [2, 3].
        n: row of the segment whose line it is.
    """
    rows = range(segments.first[view], segments.first[view + 1])
    scores = [support(segments, m, line, segments.options.reach) * same_color(segments, n, m) for m in rows]
    best = int(np.argmax(scores)) if scores else -1
    return (-1, 0.0) if best < 0 or scores[best] == 0 else (rows[best], scores[best])


def match_segment(segments: Segments, n: int, neighbours: NDArray[np.int32]) -> tuple[Array, float]:
    """Find the line [2, 3] of a segment that most neighbours see, and the sum of their supports; 0 for none."""
    best, score, view = np.zeros((2, 3)), 0.0, int(segments.view[n])
    others = [int(v) for v in neighbours[view] if v >= 0]
    for other in others:
        for m in range(segments.first[other], segments.first[other + 1]):
            line = line_of(segments, n, m) if same_color(segments, n, m) else None
            if line is None or support(segments, m, line, 1.0) == 0:
                continue
            total = sum(best_segment(segments, k, line, n)[1] for k in others)
            if total > score:
                best, score = line, total
    return best, score


def line_of(segments: Segments, n: int, m: int) -> Array | None:
    """Intersect the planes of two segments: a line [2, 3]; None outside of the box or at a small angle."""
    p, q = segments.normals[n], segments.normals[m]
    if np.linalg.norm(np.cross(p, q)) < np.sin(np.radians(segments.options.angles[0])):
        return None
    views = segments.views
    origin, slope = views.centres[segments.view[n]], segments.rays[n] @ q
    if (np.abs(slope) < 1e-4).any():
        return None
    depth = (views.centres[segments.view[m]] - origin) @ q / slope
    line = origin + depth[:, None] * segments.rays[n]
    inside = (line > views.low).all() and (line < views.high).all()
    return line if (depth > 0).all() and inside else None


def cast_ray(
    tetrahedra: Tetrahedra, point: int, centre: Array, soft: float
) -> tuple[int, list[tuple[int, int, float]]]:
    """Cast a point's ray by brute force: all faces of all tetrahedra are intersected with the segment.

    Args:
        tetrahedra: the tetrahedra.
        point: number of the point.
        centre: of the camera, [3].
        soft: uncertainty of the point along the ray.

    Returns:
        The tetrahedron of the camera, and (tetrahedron, face, share of the weight) of every face that the ray passes.
    """
    origin = tetrahedra.points[point]
    d = centre - origin
    length = float(np.linalg.norm(d))
    d = d / length
    spans = []
    for cell, planes in enumerate(face_planes(tetrahedra)):
        slope, off = planes[:, :3] @ d, planes[:, :3] @ origin + planes[:, 3]
        off[tetrahedra.corners[cell] != point] *= np.abs(off[tetrahedra.corners[cell] != point]) > 1e-12
        with np.errstate(divide="ignore", invalid="ignore"):
            at = -off / slope
        near = max(0.0, float(at[slope < -1e-12].max(initial=-np.inf)))
        far = float(at[slope > 1e-12].min(initial=np.inf))
        if far > near + 1e-9 and not ((np.abs(slope) <= 1e-12) & (off > 1e-12)).any():
            spans.append((near, far, cell))
    spans.sort()
    passed: list[tuple[int, int, float]] = []
    for (_, far, cell), (_, _, following) in pairwise(spans):
        if far >= length:
            return cell, passed
        face = int(np.flatnonzero(tetrahedra.neighbours[following] == cell)[0])
        passed.append((following, face, 1 - float(np.exp(-(far**2) / (2 * soft**2)))))
    return spans[-1][2], passed


def find_outside(points: Array, silhouettes: Silhouettes, options: OutsideOptions) -> NDArray[np.bool_]:
    """Find points outside of the visual hull as :func:`mgf_engine.start.views.find_outside` does, view by view.

    Args:
        points: [N, 3], normalised frame.
        silhouettes: the masks.
        options: how many of them call a point outside.
    """
    framed, outside = np.zeros(len(points), np.int64), np.zeros(len(points), np.int64)
    for p, distance, size in zip(silhouettes.projections, silhouettes.outside, silhouettes.sizes, strict=True):
        for n, x in enumerate(points):
            at = _projected(p, x)
            if at is not None and (at >= 0).all() and (at < size).all():
                framed[n] += 1
                outside[n] += distance[int(at[1]), int(at[0])] > 8 * options.margin
    return (outside >= options.least_views) & (outside >= np.float32(options.share) * framed.astype(np.float32))


def poisson_disk_subset(points: Array, radius: float) -> NDArray[np.int64]:
    """Choose points [N, 3] as the kernel ``mgf_poisson_disk`` does; returns their numbers."""
    kept: list[int] = []
    for n, point in enumerate(points):
        if not len(kept) or np.linalg.norm(points[kept] - point, axis=1).min() > radius:
            kept.append(n)
    return np.array(kept, np.int64)


def smooth_point(
    points: Array, row: int, neighbours: NDArray[np.int64], radius: float, offset: float, most: float
) -> tuple[Array, Array]:
    """Move a point onto the plane through its neighbours as the kernel ``mgf_smooth_points`` does.

    Args:
        points: [N, 3].
        row: the point's number.
        neighbours: numbers of its neighbours.
        radius: standard deviation of their weight by distance.
        offset: standard deviation of their weight by distance from the plane.
        most: longest move.

    Returns:
        The point [3] and the plane's unit normal [3].
    """
    near = points[neighbours]
    normal = np.linalg.svd(near - near.mean(0))[2][2]
    away, along = near - points[row], (near - points[row]) @ normal
    weight = np.exp(-(away**2).sum(1) / (2 * radius**2))
    mean = float((weight * along).sum() / weight.sum())
    for _ in range(2):
        robust = weight * np.exp(-((along - mean) ** 2) / (2 * offset**2))
        mean = float((robust * along).sum() / robust.sum())
    return points[row] + np.clip(mean, -most, most) * normal, normal


def snap_to_planes(points: Array, planes: Array, near: Array, options: PlaneOptions) -> Array:
    """Move points [N, 3] onto planes [K, 4] as :func:`mgf_engine.start.snapping.snap_to_planes` does.

    Args:
        points: [N, 3], normalised frame.
        planes: (normal, offset) of each, [K, 4].
        near: distance within which a point moves, per point.
        options: options of the planes.
    """
    normals, distance, out = planes[:, :3], points @ planes[:, :3].T + planes[:, 3], points.copy()
    for n in range(len(points)):
        rows: list[int] = []
        for k in np.argsort(np.abs(distance[n])):
            if abs(distance[n, k]) >= near[n] or len(rows) == 3:
                break
            if all(abs(normals[k] @ normals[r]) < options.common_cosine for r in rows):
                rows.append(int(k))
        if rows:
            move = -np.linalg.lstsq(normals[rows], distance[n, rows], rcond=options.common_rank)[0]
            out[n] += move if np.linalg.norm(move) < options.longest_move * near[n] else 0
    return out


def face_planes(tetrahedra: Tetrahedra) -> Array:
    """Compute outward unit normals and offsets of the faces opposite of each corner, [T, 4, 4]."""
    result = np.empty((len(tetrahedra.corners), 4, 4))
    for k, corners in enumerate(FACE_CORNERS):
        a, b, c = (tetrahedra.points[tetrahedra.corners[:, n]] for n in corners)
        n = np.cross(b - a, c - a)
        n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-300)
        result[:, k, :3], result[:, k, 3] = n, -(n * a).sum(1)
    return result


def around(tetrahedra: Tetrahedra, point: int) -> NDArray[np.int64]:
    """Return the tetrahedra around a point, ascending."""
    return np.flatnonzero((tetrahedra.corners == point).any(1))


def tetrahedron_neighbours(corners: NDArray[np.int32]) -> NDArray[np.int32]:
    """Find the tetrahedron beyond each face of tetrahedra [T, 4], opposite of a corner; -1 for none, [T, 4]."""
    holders: dict[tuple[int, ...], list[tuple[int, int]]] = {}
    for cell, four in enumerate(corners.tolist()):
        for k in range(4):
            holders.setdefault(tuple(sorted(four[:k] + four[k + 1 :])), []).append((cell, k))
    result = np.full(corners.shape, -1, np.int32)
    for sides in holders.values():
        if len(sides) == 2:
            (first, k), (second, q) = sides
            result[first, k], result[second, q] = second, first
    return result


def cut_cells(
    neighbours: NDArray[np.int32], capacity: NDArray[np.int32], excess: NDArray[np.int32]
) -> tuple[int, NDArray[np.bool_]]:
    """Cut cells as :class:`mgf_engine.start.cut_graph.Flow` does, by scipy's maximum flow of whole numbers.

    Args:
        neighbours: the cells beyond each of four faces, -1 for none, [N, 4].
        capacity: what may flow to each neighbour, [N, 4].
        excess: what may come from outside; negative: go inside, [N].

    Returns:
        The value of the flow, and which cells are inside, bool [N].
    """
    count = len(excess)
    outside, inside = count, count + 1
    cell, k = np.nonzero(neighbours >= 0)
    begin = np.r_[cell, np.full(count, outside), np.arange(count)]
    end = np.r_[neighbours[cell, k], np.arange(count), np.full(count, inside)]
    most = np.r_[capacity[cell, k], np.maximum(excess, 0), np.maximum(-excess, 0)].astype(np.int32)
    graph = csr_matrix((most, (begin, end)), shape=(count + 2, count + 2))
    found = maximum_flow(graph, outside, inside)
    left = (graph - found.flow).tocsr()
    left.data[left.data < 0] = 0
    left.eliminate_zeros()
    reached = breadth_first_order(left.T.tocsr(), inside, return_predecessors=False)
    return found.flow_value, np.isin(np.arange(count), reached)
