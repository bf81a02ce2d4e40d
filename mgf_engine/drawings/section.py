# SPDX-License-Identifier: GPL-3.0-or-later
"""Sections: where a plane cuts the mesh, as straight lines and areas to be hatched."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from mgf_engine.algorithms import parameter
from mgf_engine.drawings.facades import plan_frame
from mgf_engine.drawings.model import CUT, Area, Array, Facade, Frame, Line, LineDrawing, Survey
from mgf_engine.drawings.straighten import StraightenOptions, straighten
from mgf_engine.errors import BadInput


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


def section_frames(
    survey: Survey,
    facades: Sequence[Facade],
    wanted: Sequence[str],
    ground: float,
    options: SectionOptions = SectionOptions(),
) -> list[Frame]:
    """Return the planes to cut at.

    Level ones are given as ``z=1.2`` above the ground, upright ones as ``A=3.5`` from a facade's left end, any others
    as ``NAME=x,y,z,nx,ny,nz`` by a point and a normal of the scene frame.

    Without any wanted, a plan and two cross-sections through the middle.

    Args:
        survey: mesh of the job, local frame.
        facades: by whose names upright planes are given.
        wanted: texts of ``--section``.
        ground: height of the ground, local frame.
        options: height of the plan.

    Raises:
        BadInput: a text names no facade, no number, or a plane beside the building; or two have one name.
    """
    if wanted:
        frames = [_frame_of(survey, facades, text, ground, options) for text in wanted]
        names = [frame.name for frame in frames]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise BadInput(f"Two sections are called {twice}; give each --section a name of its own.")
        return frames
    height = float(survey.mesh.vertices[:, 2].max()) - ground
    level = options.plan_height if survey.georeference.metric and height > options.plan_height else 0.25 * height
    first = facades[0]
    across = max(facades, key=lambda f: abs(float(f.frame.normal @ first.frame.x)))
    through = [first] if across is first else [first, across]
    return [
        _level(survey, facades, ground, level),
        *(_upright(survey, f, 0.5 * float(f.frame.size[0])) for f in through),
    ]


def cut(survey: Survey, frame: Frame, options: SectionOptions = SectionOptions()) -> Cut:
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
    lines = [Line(ring, CUT) for area in areas for ring in (area.outer, *area.holes)]
    lines += [
        Line(
            straighten(_resampled(path, options.spacing * pixel), (0, 1), pixel, options=options.straightening).points,
            CUT,
        )
        for path in loose
    ]
    total = sum(ring_area(a.outer) - sum(map(ring_area, a.holes)) for a in areas)
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


def _frame_of(survey: Survey, facades: Sequence[Facade], text: str, ground: float, options: SectionOptions) -> Frame:
    plane = re.fullmatch(r"\s*([\w-]+)\s*=([-+0-9.eE\s]+(?:,[-+0-9.eE\s]+){5})", text)
    if plane is not None:
        return _along_plane(survey, facades, text, plane.group(1), plane.group(2), options)
    match = re.fullmatch(r"\s*([\w-]+)\s*=\s*([-+0-9.eE]+)\s*", text)
    known = {facade.name: facade for facade in facades}
    names = ", ".join(["z", *known])
    try:
        name, value = match.group(1), float(match.group(2))  # type: ignore[union-attr]
        if not np.isfinite(value) or not (name == "z" or name in known):
            raise ValueError(name)
    except (AttributeError, ValueError) as error:
        raise BadInput(
            f"--section takes NAME=DISTANCE with NAME one of {names}, or NAME=x,y,z,nx,ny,nz, not '{text}'."
        ) from error
    low, high = 0.0, float(known[name].frame.size[0]) if name != "z" else 0.0
    if name == "z":
        z = survey.mesh.vertices[:, 2]
        low, high = float(z.min()) - ground, float(z.max()) - ground
    if not low < value < high:
        raise BadInput(f"The section {text} misses the building, which reaches from {low:.3f} to {high:.3f} there.")
    return _level(survey, facades, ground, value) if name == "z" else _upright(survey, known[name], value)


def _along_plane(
    survey: Survey, facades: Sequence[Facade], text: str, name: str, numbers: str, options: SectionOptions
) -> Frame:
    """Cut through a point along a plane, both of the scene frame; seen from the side that the normal points to.

    Raises:
        BadInput: the numbers are none, or the normal has no direction.
    """
    try:
        values = np.array([float(number) for number in numbers.split(",")])
    except ValueError:
        values = np.full(6, np.nan)
    length = float(np.linalg.norm(values[3:]))
    if not np.isfinite(values).all() or not length > 0:
        raise BadInput(f"The section '{text}' is no plane; give NAME=x,y,z,nx,ny,nz with a normal that is not zero.")
    point = survey.local(values[:3])
    normal = survey.turn @ survey.georeference.rotation @ values[3:] / length
    if np.hypot(normal[0], normal[1]) < np.sin(np.radians(options.level_angle)):
        plan = plan_frame(survey, list(facades))
        return Frame(name, plan.origin + point[2] * plan.normal, plan.x, plan.y, plan.low, plan.high)
    up = np.array([0.0, 0.0, 1.0])
    if abs(normal[2]) < np.sin(np.radians(options.level_angle)):
        normal = np.array([normal[0], normal[1], 0.0]) / np.hypot(normal[0], normal[1])
        point = point - point[2] * up  # its y is the height
    x = np.cross(up, normal) / np.hypot(normal[0], normal[1])
    frame = Frame(name, point, x, np.cross(normal, x), np.zeros(2), np.zeros(2))
    at = frame.to_drawing(survey.mesh.vertices)[:, :2]
    origin = point + at[:, 0].min() * x  # x begins at its left end
    low, high = at.min(0) - (at[:, 0].min(), 0), at.max(0) - (at[:, 0].min(), 0)
    return Frame(name, origin, x, frame.y, low, high)


def _level(survey: Survey, facades: Sequence[Facade], ground: float, above: float) -> Frame:
    plan = plan_frame(survey, list(facades))
    z = ground + above
    return Frame(f"z-{above:.3g}", plan.origin + z * plan.normal, plan.x, plan.y, plan.low, plan.high)


def _upright(survey: Survey, facade: Facade, distance: float) -> Frame:
    """Cut upright across a facade, seen from its left end."""
    normal, up = -facade.frame.x, np.array([0.0, 0.0, 1.0])
    origin = facade.frame.origin + facade.frame.x * (facade.frame.low[0] + distance)
    frame = Frame(f"{facade.name}-{distance:.3g}", origin, np.cross(up, normal), up, np.zeros(2), np.zeros(2))
    at = frame.to_drawing(survey.mesh.vertices)[:, :2]
    return Frame(frame.name, origin, frame.x, up, at.min(0), at.max(0))


def _paths(survey: Survey, frame: Frame) -> list[Array]:
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


def _areas(rings: list[Array], least: float) -> list[Area]:
    """Return what lies inside an odd number of rings."""
    from shapely import MultiPolygon, Polygon

    polygons = [Polygon(ring).buffer(0) for ring in rings if len(ring) > 3]
    if not polygons:
        return []
    inside = reduce(lambda one, other: one.symmetric_difference(other), polygons)
    parts = inside.geoms if isinstance(inside, MultiPolygon) else [inside]
    return [
        Area(
            np.array(part.exterior.coords),
            tuple(np.array(hole.coords) for hole in part.interiors if Polygon(hole).area > least),
        )
        for part in parts
        if part.geom_type == "Polygon" and part.area > least
    ]


def ring_area(ring: Array) -> float:
    """Return the area inside a closed ring [N, 2]."""
    x, y = (ring - ring[0]).T
    return 0.5 * abs(float(x[:-1] @ y[1:] - x[1:] @ y[:-1]))


def _length(path: Array) -> float:
    return float(np.hypot(*np.diff(path, axis=0).T).sum())
