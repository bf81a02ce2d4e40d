# SPDX-License-Identifier: GPL-3.0-or-later
"""Topology of a mesh: corners around vertices, connected components, fans, open edges, neighbours.

``csrc/mesh/topology.c`` does the work, vertex by vertex; plain references are in ``tests/model/test_topology.py``.
A corner is the number ``3 * face + place``; its edge leads to the next vertex of the face.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.native.library import call, parallel


@dataclass(frozen=True)
class Adjacency:
    """The corners around each vertex of a mesh.

    Attributes:
        faces: int32 [F, 3].
        start: int32 [N + 1]; vertex v has ``corner[start[v]:start[v + 1]]``.
        corner: int32 [3 F], ascending around each vertex.
    """

    faces: NDArray[np.int32]
    start: NDArray[np.int32]
    corner: NDArray[np.int32]

    @classmethod
    def of(cls, faces: NDArray[np.int32], vertices: int) -> Adjacency:
        """Return those of ``faces`` between ``vertices`` vertices."""
        faces = np.ascontiguousarray(faces, dtype=np.int32)
        result = cls(faces, np.empty(vertices + 1, np.int32), np.empty(3 * len(faces), np.int32))
        call("mgf_corners_around", vertices, len(faces), *result._all)
        return result

    @property
    def _all(self) -> tuple[NDArray[np.int32], ...]:
        return self.faces, self.start, self.corner

    def parts(self) -> NDArray[np.int32]:
        """Return which part, connected by edges, each face belongs to, int32 [F], in the order of their first faces."""
        part = np.empty(len(self.faces), np.int32)
        call("mgf_face_components", len(self.start) - 1, len(self.faces), *self._all, part)
        return part

    def open_edges(self) -> NDArray[np.bool_]:
        """Return corners whose edge no other face uses, bool [F, 3]."""
        alone = np.zeros(self.faces.shape, np.uint8)
        parallel("mgf_open_edges", len(self.start) - 1, *self._all, alone)
        return alone.astype(bool)

    def fans(self) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Find the fans of faces around each vertex: faces joined by edges that two use, in opposite directions.

        Returns:
            The fan that each corner belongs to, int32 [3 F] in the order of ``corner``, and the number of fans of each
            vertex, int32 [N].
        """
        fan, count = np.empty(len(self.corner), np.int32), np.empty(len(self.start) - 1, np.int32)
        parallel("mgf_vertex_fans", len(count), *self._all, fan, count)
        return fan, count

    def neighbours(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Find the vertices that an edge joins with each vertex, ascending.

        Returns:
            ``start`` [N + 1] and ``neighbour``: those of vertex v are ``neighbour[start[v]:start[v + 1]]``.
        """
        count = len(self.start) - 1
        a, b = directed_edges(self.faces)
        first, neighbour = np.divmod(distinct(a * count + b), max(count, 1))
        return np.searchsorted(first, np.arange(count + 1)), neighbour

    def smooth(self, at: NDArray[np.float64], fixed: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return vertices [N, 3], all but the ``fixed`` [N] half way towards the mean of their neighbours."""
        moved = np.empty_like(at)
        parallel("mgf_smooth_vertices", len(at), *self._all, fixed.view(np.uint8), at, moved)
        return moved

    def vertex_normals(self, at: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the sum of the normals of the faces around each vertex, weighted by twice their areas, [N, 3]."""
        normals = np.empty((len(at), 3))
        parallel("mgf_vertex_normals", len(at), *self._all, np.ascontiguousarray(at, dtype=np.float64), normals)
        return normals


def half_edges(faces: NDArray[np.integer]) -> NDArray[np.int64]:
    """List the edges of each face [F, 3] in its direction, each by its two vertices, int64 [3 F, 2]."""
    return np.stack([faces, np.roll(faces, -1, axis=1)], 2).reshape(-1, 2).astype(np.int64)


def directed_edges(faces: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """List each edge of each face [F, 3] in both directions: its two vertices, int64 [6 F] each."""
    start, end = half_edges(faces).T
    return np.r_[start, end], np.r_[end, start]


def distinct(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Sort numbers [K] and leave out repetitions; faster than ``numpy.unique``, which hashes them."""
    ordered = np.sort(keys)
    return ordered[np.r_[True, ordered[1:] != ordered[:-1]][: len(ordered)]]
