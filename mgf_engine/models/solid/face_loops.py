# SPDX-License-Identifier: GPL-3.0-or-later
"""Faces of a solid as few loops of corners: faces in one plane become one, short edges and needless corners go."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable

import numpy as np
import shapely

from mgf_engine.models.solid.model import ROOF, Array, SolidFace, plane_axes, signed_ring_area

Ring = list[int]


def without_repeats(ring: Ring) -> Ring:
    """Drop corners that follow themselves."""
    return [row for k, row in enumerate(ring) if row != ring[k - 1]]


def merge_faces(vertices: Array, kind: str, plane: int, rings: list[Ring]) -> Iterable[SolidFace]:
    """Merge faces in one plane into few: edges that two of them share go, and what is left is traced.

    Args:
        vertices: [N, 3].
        kind: of the faces, such as :data:`~mgf_engine.models.solid.model.ROOF`.
        plane: number of the roof plane.
        rings: rows of vertices of each face, counter-clockwise seen from outside.
    """
    edges: set[tuple[int, int]] = set()
    for ring in rings:
        for u, v in zip(ring, ring[1:] + ring[:1], strict=True):
            if (v, u) in edges:
                edges.remove((v, u))
            else:
                edges.add((u, v))
    total = sum((np.cross(vertices[r[1:-1]] - vertices[r[0]], vertices[r[2:]] - vertices[r[0]]).sum(0) for r in rings),
                np.zeros(3))  # fmt: skip
    axes = plane_axes(total / max(float(np.linalg.norm(total)), 1e-300))
    flat = vertices @ axes.T
    loops = [loop for walk in _walks(edges, flat) for loop in _simple(walk)]
    outer = [loop for loop in loops if signed_ring_area(flat[loop]) > 0]
    holes: dict[int, list[Ring]] = defaultdict(list)
    shapes = [shapely.Polygon(flat[loop]) for loop in outer]
    for loop in loops:
        if signed_ring_area(flat[loop]) < 0:
            inside = shapely.Polygon(flat[loop]).representative_point()
            holds = [k for k, shape in enumerate(shapes) if shape.contains(inside)]
            holes[min(holds, key=lambda k: shapes[k].area)].append(loop)
    for k, loop in enumerate(outer):
        yield SolidFace(kind, (tuple(loop), *(tuple(hole) for hole in holes[k])), plane if kind == ROOF else -1)


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


def drop_short_edges(vertices: Array, faces: list[SolidFace], least: float) -> list[SolidFace]:
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
        rings = [tuple(without_repeats([first(row) for row in ring])) for ring in face.rings]
        rings = [ring for k, ring in enumerate(rings) if len(ring) > 2 or k == 0]
        if len(rings[0]) > 2:
            kept.append(SolidFace(face.kind, tuple(rings), face.plane))
    return kept


def drop_straight_corners(vertices: Array, faces: list[SolidFace], step: float) -> list[SolidFace]:
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
