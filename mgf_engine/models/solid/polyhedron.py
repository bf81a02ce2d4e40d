# SPDX-License-Identifier: GPL-3.0-or-later
"""From labelled cells to a closed polyhedron: roof over each cell, walls where heights differ, ground below.

Corners are numbered by place in the plan and level there, so neighbouring faces share them exactly; faces in one plane
become one face, and corners in the middle of straight edges go.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mgf_engine.models.solid.cells import Cells
from mgf_engine.models.solid.face_loops import (
    Ring,
    drop_short_edges,
    drop_straight_corners,
    merge_faces,
    without_repeats,
)
from mgf_engine.models.solid.model import GROUND, ROOF, WALL, Array, Solid, SolidFace
from mgf_engine.models.solid.plan_lines import Line2
from mgf_engine.options.algorithms import parameter


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
        wall = without_repeats([*reversed(corners.between(start, low, high)), *corners.between(end, low, high)])
        if len(wall) > 2:
            faces[(WALL, *_line_of(cells, start, end, lines))].append(wall)
    vertices = np.array(corners.places).reshape(-1, 3)
    made = [face for (kind, plane, _), rings in faces.items() for face in merge_faces(vertices, kind, plane, rings)]
    made = drop_short_edges(vertices, made, options.short_edge * cells.step)
    return _compact(vertices, drop_straight_corners(vertices, made, cells.step))


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


def _compact(vertices: Array, faces: list[SolidFace]) -> Solid:
    """Return the solid with the vertices that its faces have, and no others."""
    used = sorted({row for face in faces for ring in face.rings for row in ring})
    number = {row: k for k, row in enumerate(used)}
    renamed = [SolidFace(f.kind, tuple(tuple(number[x] for x in ring) for ring in f.rings), f.plane) for f in faces]
    return Solid(vertices[used], renamed)
