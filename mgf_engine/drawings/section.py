# SPDX-License-Identifier: GPL-3.0-or-later
"""Sections: where a plane cuts the mesh, as straight lines and areas to be hatched."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray
from shapely import MultiPolygon, Polygon

from mgf_engine.drawings.model import CUT, Array, DrawingFrame, LineDrawing, Polyline, Survey, rings_of
from mgf_engine.drawings.straighten import StraightenOptions, straighten
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class SectionOptions:
    """Options of sections."""

    spacing: float = parameter(
        0.5, "Distance between the points of a cut before it is straightened", "ground px", low=0.01
    )
    in_ground: float = parameter(
        0.2, "Share of the building's height below which open ends of walls are joined", high=1
    )
    bridge: float = parameter(8.0, "Largest gap between two ends of a cut that is bridged", "ground px")
    least_area: float = parameter(9.0, "Minimum area inside a cut, and square of its minimum length", "ground px²")
    level_angle: float = parameter(2.0, "Angle below which a plane is made level or upright", "degrees", high=45)
    plan_height: float = parameter(1.2, "Height above the ground at which a plan is cut", "m")
    straightening: StraightenOptions = StraightenOptions()


@dataclass(frozen=True)
class Cut:
    """A section.

    Attributes:
        drawing: its lines and areas.
        area: that it cuts.
        closed: all of it could be closed.
        bridged: length of the gaps in the mesh that straight lines bridge.
    """

    drawing: LineDrawing
    area: float
    closed: bool
    bridged: float = 0.0


def cut(survey: Survey, frame: DrawingFrame, options: SectionOptions = SectionOptions()) -> Cut:
    """Cut the mesh by the frame's plane."""
    pixel = survey.working_pixel
    paths = [frame.to_drawing(path)[:, :2] for path in _paths(survey, frame)]
    paths = [path for path in paths if _length(path) ** 2 > options.least_area * pixel**2]
    upright = abs(float(frame.normal[2])) < 0.5
    rings, loose = [p for p in paths if (p[0] == p[-1]).all()], [p for p in paths if not (p[0] == p[-1]).all()]
    loose, bridged = _bridged(loose, options.bridge * pixel)
    low = float(frame.low[1] + options.in_ground * frame.size[1])
    for path in list(loose):
        in_ground = upright and max(path[0, 1], path[-1, 1]) < low
        if in_ground or np.hypot(*(path[0] - path[-1])) < 4 * pixel:
            rings.append(np.concatenate([path, path[:1]]))
            loose = [other for other in loose if other is not path]
    straight = [
        straighten(_resampled(ring, options.spacing * pixel), (0, 0), pixel, options=options.straightening).points
        for ring in rings
    ]
    areas = _areas(straight, options.least_area * pixel**2)
    lines = [Polyline(ring, CUT) for area in areas for ring in rings_of(area)]
    lines += [
        Polyline(
            straighten(_resampled(path, options.spacing * pixel), (0, 1), pixel, options=options.straightening).points,
            CUT,
        )
        for path in loose
    ]
    total = sum(area.area for area in areas)
    return Cut(LineDrawing(frame, lines, areas), total, not loose, bridged)


def _bridged(paths: list[Array], most: float) -> tuple[list[Array], float]:
    """Join open polylines [n, 2] where ends of two of them are near, the nearest first; returns them, and the length of
    all gaps."""
    paths, length = list(paths), 0.0
    while len(paths) > 1:
        ends = np.array([path[[0, -1]] for path in paths])  # [P, 2, 2]
        away = np.linalg.norm(ends[:, None, :, None] - ends[None, :, None, :], axis=-1)  # [P, P, 2, 2]
        away[np.arange(len(paths)), np.arange(len(paths))] = np.inf
        one, other, at_one, at_other = np.unravel_index(int(away.argmin()), away.shape)
        if away[one, other, at_one, at_other] > most:
            break
        length += float(away[one, other, at_one, at_other])
        first = paths[one] if at_one == 1 else paths[one][::-1]
        second = paths[other] if at_other == 0 else paths[other][::-1]
        paths = [path for k, path in enumerate(paths) if k not in (one, other)]
        paths.append(np.concatenate([first, second]))
    return paths, length


def _paths(survey: Survey, frame: DrawingFrame) -> list[Array]:
    """Find where the plane cuts the mesh, as polylines [n, 3] in the local frame; closed ones repeat their first
    point."""
    before = (survey.mesh.vertices - frame.origin) @ frame.normal
    faces = survey.mesh.faces
    above = before > 0  # vertices in the plane count as below it, so that each cut face has two cut edges
    crossed = np.flatnonzero(above[faces].any(1) & ~above[faces].all(1))
    ends = np.stack([faces[crossed], np.roll(faces[crossed], -1, axis=1)], 2)  # [K, 3, 2]
    split = above[ends[..., 0]] != above[ends[..., 1]]
    pairs, node = np.unique(np.sort(ends[split], axis=1), axis=0, return_inverse=True)
    share = before[pairs[:, 0]] / (before[pairs[:, 0]] - before[pairs[:, 1]])
    low, high = survey.mesh.vertices[pairs[:, 0]], survey.mesh.vertices[pairs[:, 1]]
    points = low + share[:, None] * (high - low)
    return [points[path] for path in _walk(node.reshape(-1, 2), len(points))]


def _walk(edges: NDArray[np.int64], count: int) -> list[list[int]]:
    """Walk the nodes of each path through edges [E, 2]: open ones from end to end, then closed ones."""
    around: list[list[tuple[int, int]]] = [[] for _ in range(count)]
    for k, (a, b) in enumerate(edges.tolist()):
        around[a].append((k, b))
        around[b].append((k, a))
    used, paths = np.zeros(len(edges), bool), []
    order = sorted(range(count), key=lambda n: len(around[n]) == 2)
    for begin in order:
        while any(not used[k] for k, _ in around[begin]):
            path = [begin]
            while True:
                step = next(((k, n) for k, n in around[path[-1]] if not used[k]), None)
                if step is None:
                    break
                used[step[0]] = True
                path.append(step[1])
                if step[1] == begin:
                    break
            paths.append(path)
    return paths


def _resampled(path: Array, spacing: float) -> Array:
    """Place points at even distances along a polyline, its corners kept."""
    steps = np.hypot(*np.diff(path, axis=0).T)
    parts = [
        path[k] + np.arange(n := max(1, int(np.ceil(step / spacing))))[:, None] / n * (path[k + 1] - path[k])
        for k, step in enumerate(steps)
        if step > 0
    ]
    return np.concatenate([*parts, path[-1:]])


def _areas(rings: list[Array], least: float) -> list[Polygon]:
    """Return the areas inside an odd number of rings (even-odd rule), those of at least ``least`` square units."""
    polygons = [Polygon(ring).buffer(0) for ring in rings if len(ring) > 3]
    if not polygons:
        return []
    inside = reduce(lambda one, other: one.symmetric_difference(other), polygons)
    parts = inside.geoms if isinstance(inside, MultiPolygon) else [inside]
    return [
        Polygon(part.exterior, [hole for hole in part.interiors if Polygon(hole).area > least])
        for part in parts
        if part.geom_type == "Polygon" and part.area > least
    ]


def _length(path: Array) -> float:
    return float(np.hypot(*np.diff(path, axis=0).T).sum())
