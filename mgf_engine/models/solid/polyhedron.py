# SPDX-License-Identifier: GPL-3.0-or-later
"""From labelled cells to a closed polyhedron: roof over each cell, walls where heights differ, ground below.

Corners are numbered by place in the plan and level there, so neighbouring faces share them exactly; faces in one plane
become one face, and corners in the middle of straight edges go.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
import shapely
from numpy.typing import NDArray

from mgf_engine.algorithms import parameter
from mgf_engine.models.solid.cells import Cells
from mgf_engine.models.solid.model import GROUND, ROOF, WALL, Array, Solid, SolidFace
from mgf_engine.models.solid.plan_lines import Line2

Ring = list[int]


@dataclass(frozen=True)
class PolyhedronOptions:
    """Options of the faces of a solid; a step is that of the grid that the ground plan's corners lie on."""

    one_height: float = parameter(2.5, "Difference of heights at a corner up to which they are one, in steps")
    short_edge: float = parameter(6.0, "Length below which an edge becomes one corner, in steps")


@dataclass
class _Corners:
    """Corners of the polyhedron: (node, level of heights there) -> row."""

    cells: Cells
    heights: list[dict[int, float]]
    rows: dict[tuple[int, float], int] = field(default_factory=dict)
    places: list[tuple[float, float, float]] = field(default_factory=list)

    def row(self, node: int, label: int) -> int:
        z = self.heights[node][label]
        if (node, z) not in self.rows:
            self.rows[node, z] = len(self.places)
            self.places.append((*self.cells.nodes[node], z))
        return self.rows[node, z]

    def between(self, node: int, low: int, high: int) -> Ring:
        """Return rows at a node from the height of one label up to that of another, both included."""
        levels = self.heights[node]
        found = sorted({(z, label) for label, z in levels.items() if levels[low] <= z <= levels[high]})
        return list(dict.fromkeys(self.row(node, label) for _, label in found))


def make_polyhedron(
    cells: Cells,
    label: NDArray[np.int64],
    slopes: Array,
    ground: float,
    lines: Sequence[Line2],
    options: PolyhedronOptions = PolyhedronOptions(),
) -> Solid:
    """Make the solid of labelled cells.

    Args:
        cells: of the ground plan.
        label: of each cell, 0 outside, k + 1 the k-th of ``slopes``.
        slopes: [P, 3], planes ``z = a x + b y + c``.
        ground: height of the floor.
        lines: that the cells were cut along; walls on one line become one face.
        options: what is too near to be two corners.
    """
    of = [*label.tolist(), 0]  # the last is what OUTSIDE points to
    near = options.one_height * cells.step
    _split_crossings(cells, of, slopes, ground, near)
    corners = _Corners(cells, _heights(cells, of, slopes, ground, near))
    faces: dict[tuple[str, int, int], list[Ring]] = defaultdict(list)
    for k, ring in enumerate(cells.rings):
        if of[k]:
            faces[ROOF, of[k] - 1, 0].append([corners.row(node, of[k]) for node in ring])
            faces[GROUND, -1, 0].append([corners.row(node, 0) for node in reversed(ring)])
    for u, v, left, right in cells.borders():
        a, b = of[left], of[right]
        if a == b:
            continue
        za, zb = (sum(corners.heights[n][x] for n in (u, v)) for x in (a, b))
        start, end, low, high = (u, v, b, a) if za > zb else (v, u, a, b)
        wall = _without_repeats([*reversed(corners.between(start, low, high)), *corners.between(end, low, high)])
        if len(wall) > 2:
            faces[(WALL, *_line_of(cells, start, end, lines))].append(wall)
    vertices = np.array(corners.places).reshape(-1, 3)
    made = [face for (kind, plane, _), rings in faces.items() for face in _merged(vertices, kind, plane, rings)]
    made = _without_short(vertices, made, options.short_edge * cells.step)
    return _compact(vertices, _without_straight(vertices, made, cells.step))


def faults_of(solid: Solid, tolerance: float) -> list[str]:
    """Return what is wrong with a solid, in words; empty for a closed, oriented, plane-faced 2-manifold with volume."""
    faults, count = [], dict[tuple[int, int], int]()
    for face in solid.faces:
        for ring in face.rings:
            for edge in zip(ring, ring[1:] + ring[:1], strict=True):
                count[edge] = count.get(edge, 0) + 1
    if any(n > 1 for n in count.values()):
        faults.append("an edge belongs to more than two faces")
    if any((v, u) not in count for u, v in count):
        faults.append("an edge belongs to one face only")
    for face in solid.faces:
        points = solid.vertices[[row for ring in face.rings for row in ring]]
        off = (points - points[0]) @ solid.normal(face)
        if np.ptp(off) > tolerance:
            faults.append("a face is not plane")
            break
    if not solid.faces or volume_of(solid) <= 0:
        faults.append("it has no volume")
    return faults


def triangles(solid: Solid) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return triangles between a solid's own vertices [T, 3], and the face of each [T]."""
    rows, owner = list[NDArray[np.int32]](), list[int]()
    for k, face in enumerate(solid.faces):
        axes = _axes(solid.normal(face))
        at = {row: solid.vertices[row] @ axes.T for ring in face.rings for row in ring}
        known = {tuple(np.round(place, 7).tolist()): row for row, place in at.items()}
        shape = shapely.Polygon([at[row] for row in face.rings[0]], [[at[r] for r in ring] for ring in face.rings[1:]])
        for part in shapely.constrained_delaunay_triangles(shapely.normalize(shape)).geoms:
            ring = shapely.get_coordinates(shapely.orient_polygons(part).exterior)[:3]
            rows.append(np.array([known[tuple(np.round(place, 7).tolist())] for place in ring], np.int32))
            owner.append(k)
    return np.array(rows, np.int32).reshape(-1, 3), np.array(owner, np.int64)


def volume_of(solid: Solid) -> float:
    """Compute the enclosed volume by the divergence theorem; negative where faces point inwards."""
    origin = solid.vertices.mean(0)
    return sum(
        float((solid.vertices[face.rings[0][0]] - origin) @ solid.normal(face)) * solid.area(face) / 3
        for face in solid.faces
    )


def _split_crossings(cells: Cells, of: list[int], slopes: Array, ground: float, near: float) -> None:
    """Put a corner where the heights of two labels change places along an edge."""
    for u, v, left, right in cells.borders():
        a, b = of[left], of[right]
        if a == b:
            continue
        ends = [_height(cells.nodes[n], a, slopes, ground) - _height(cells.nodes[n], b, slopes, ground) for n in (u, v)]
        if min(ends) < -near and max(ends) > near:
            share = ends[0] / (ends[0] - ends[1])
            (x, y), (p, q) = cells.nodes[u], cells.nodes[v]
            cells.divide(u, v, (x + share * (p - x), y + share * (q - y)))


def _height(at: tuple[float, float], label: int, slopes: Array, ground: float) -> float:
    return float(slopes[label - 1] @ (*at, 1.0)) if label else ground


def _heights(cells: Cells, of: list[int], slopes: Array, ground: float, near: float) -> list[dict[int, float]]:
    """Return the height of each label at each node, those that are near made one; the ground stays where it is."""
    around: list[set[int]] = [{0} for _ in cells.nodes]
    for cell, ring in enumerate(cells.rings):
        for node in ring:
            around[node].add(of[cell])
    result = []
    for node, labels in enumerate(around):
        order = sorted((_height(cells.nodes[node], x, slopes, ground), x) for x in labels)
        groups: list[list[tuple[float, int]]] = []
        for z, x in order:
            if groups and z - groups[-1][-1][0] <= near:
                groups[-1].append((z, x))
            else:
                groups.append([(z, x)])
        heights = {}
        for group in groups:
            z = ground if any(x == 0 for _, x in group) else sum(z for z, _ in group) / len(group)
            heights.update({x: z for _, x in group})
        result.append(heights)
    return result


def _line_of(cells: Cells, u: int, v: int, lines: Sequence[Line2]) -> tuple[int, int]:
    """Return the number of the line that an edge lies on, and which of its sides is outside; numbers of its own where
    on none."""
    ends = np.array([cells.nodes[u], cells.nodes[v]])
    along = ends[1] - ends[0]
    for k, line in enumerate(lines):
        if np.abs(ends @ line.normal - line.offset).max() <= 2 * cells.step:
            return k, 1 if line.along @ along > 0 else -1
    return len(lines) + min(u, v) * len(cells.nodes) + max(u, v), 1


def _without_repeats(ring: Ring) -> Ring:
    return [row for k, row in enumerate(ring) if row != ring[k - 1]]


def _merged(vertices: Array, kind: str, plane: int, rings: list[Ring]) -> Iterable[SolidFace]:
    """Merge faces in one plane into few: edges that two of them share go, and what is left is traced."""
    edges: set[tuple[int, int]] = set()
    for ring in rings:
        for u, v in zip(ring, ring[1:] + ring[:1], strict=True):
            if (v, u) in edges:
                edges.remove((v, u))
            else:
                edges.add((u, v))
    total = sum((np.cross(vertices[r[1:-1]] - vertices[r[0]], vertices[r[2:]] - vertices[r[0]]).sum(0) for r in rings),
                np.zeros(3))  # fmt: skip
    axes = _axes(total / max(float(np.linalg.norm(total)), 1e-300))
    flat = vertices @ axes.T
    loops = [loop for walk in _walks(edges, flat) for loop in _simple(walk)]
    outer = [loop for loop in loops if _area(flat[loop]) > 0]
    holes: dict[int, list[Ring]] = defaultdict(list)
    shapes = [shapely.Polygon(flat[loop]) for loop in outer]
    for loop in loops:
        if _area(flat[loop]) < 0:
            inside = shapely.Polygon(flat[loop]).representative_point()
            holds = [k for k, shape in enumerate(shapes) if shape.contains(inside)]
            holes[min(holds, key=lambda k: shapes[k].area)].append(loop)
    for k, loop in enumerate(outer):
        yield SolidFace(kind, (tuple(loop), *(tuple(hole) for hole in holes[k])), plane if kind == ROOF else -1)


def _axes(normal: Array) -> Array:
    """Return two unit axes in a plane, [2, 3], counter-clockwise seen from where its normal points."""
    helper = np.eye(3)[int(np.abs(normal).argmin())]
    x = np.cross(helper, normal)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(normal, x)])


def _area(ring: Array) -> float:
    x, y = (ring - ring[0]).T
    return 0.5 * float(x @ np.roll(y, -1) - np.roll(x, -1) @ y)


def _walks(edges: set[tuple[int, int]], flat: Array) -> list[Ring]:
    """Walk along directed edges with the face on their left, turning left as far as possible, in closed walks."""
    leaving: dict[int, list[int]] = defaultdict(list)
    for u, v in sorted(edges):
        leaving[u].append(v)
    walks = []
    while leaving:
        start = next(iter(leaving))
        walk, before, now = [start], -1, start
        while True:
            choices = leaving[now]
            best = 0 if before < 0 or len(choices) == 1 else _leftmost(flat, before, now, choices)
            after = choices.pop(best)
            if not choices:
                del leaving[now]
            if after == start and start not in leaving:
                break
            walk.append(after)
            before, now = now, after
            if now not in leaving:
                break
        walks.append(walk)
    return walks


def _leftmost(flat: Array, before: int, now: int, choices: list[int]) -> int:
    back = flat[before] - flat[now]
    turns = []
    for node in choices:
        ahead = flat[node] - flat[now]
        angle = float(np.arctan2(back[0] * ahead[1] - back[1] * ahead[0], back @ ahead)) % (2 * np.pi)
        turns.append(-angle)  # clockwise from where one came: the first to be met has the face on its left
    return int(np.argmin([turn % (2 * np.pi) for turn in turns]))


def _simple(walk: Ring) -> list[Ring]:
    """Split a closed walk into loops that meet no corner twice."""
    loops, path, place = [], list[int](), dict[int, int]()
    for node in walk:
        if node in place:
            first = place[node]
            loops.append(path[first:])
            for gone in path[first + 1 :]:
                del place[gone]
            del path[first + 1 :]
        else:
            place[node] = len(path)
            path.append(node)
    loops.append(path)
    return [loop for loop in loops if len(loop) > 2]


def _without_short(vertices: Array, faces: list[SolidFace], least: float) -> list[SolidFace]:
    """Make one corner of both ends of edges shorter than ``least``, as where three lines nearly meet."""
    into = list(range(len(vertices)))

    def first(row: int) -> int:
        while into[row] != row:
            row = into[row]
        return row

    for face in faces:
        for ring in face.rings:
            for u, v in zip(ring, ring[1:] + ring[:1], strict=True):
                if np.linalg.norm(vertices[u] - vertices[v]) < least:
                    into[max(first(u), first(v))] = min(first(u), first(v))
    kept = []
    for face in faces:
        rings = [tuple(_without_repeats([first(row) for row in ring])) for ring in face.rings]
        rings = [ring for k, ring in enumerate(rings) if len(ring) > 2 or k == 0]
        if len(rings[0]) > 2:
            kept.append(SolidFace(face.kind, tuple(rings), face.plane))
    return kept


def _without_straight(vertices: Array, faces: list[SolidFace], step: float) -> list[SolidFace]:
    """Drop corners at which a straight edge goes on, and nothing else, but for a step of the grid."""
    met: dict[int, set[int]] = defaultdict(set)
    for face in faces:
        for ring in face.rings:
            for u, v in zip(ring, ring[1:] + ring[:1], strict=True):
                met[u].add(v)
                met[v].add(u)
    gone = set()
    for node, others in met.items():
        if len(others) == 2:
            one, other = (vertices[x] - vertices[node] for x in others)
            off = np.linalg.norm(np.cross(one, other)) / max(float(np.linalg.norm(one - other)), 1e-300)
            if off <= 1.5 * step and one @ other < 0:
                gone.add(node)
    kept = [
        SolidFace(face.kind, tuple(tuple(x for x in ring if x not in gone) for ring in face.rings), face.plane)
        for face in faces
    ]
    return [face for face in kept if len(face.rings[0]) > 2]


def _compact(vertices: Array, faces: list[SolidFace]) -> Solid:
    """Return the solid with the vertices that its faces have, and no others."""
    used = sorted({row for face in faces for ring in face.rings for row in ring})
    number = {row: k for k, row in enumerate(used)}
    renamed = [SolidFace(f.kind, tuple(tuple(number[x] for x in ring) for ring in f.rings), f.plane) for f in faces]
    return Solid(vertices[used], renamed)
