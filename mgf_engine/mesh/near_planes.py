# SPDX-License-Identifier: GPL-3.0-or-later
"""Find the planes near each vertex, as pairs of a vertex and a plane."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mgf_engine.mesh.plane_detection import Planes
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.topology import distinct

Index = NDArray[np.int64]


@dataclass(frozen=True)
class NearPlanes:
    """Pairs of a vertex and a plane, ordered by vertex.

    Attributes:
        vertex, plane: numbers, [K] each.
    """

    vertex: Index
    plane: Index

    @cached_property
    def begin(self) -> Index:
        """Where the pairs of each vertex that has one begin, and their number, [V + 1]."""
        return np.r_[np.flatnonzero(np.r_[True, self.vertex[1:] != self.vertex[:-1]]), len(self.vertex)]


def near_planes(mesh: Mesh, pixel: NDArray[np.float64], planes: Planes, reach: float, rings: int) -> NearPlanes:
    """Find the planes that each vertex is near, by distance and along edges.

    Args:
        mesh: whose faces ``planes`` labels.
        pixel: size of a ground pixel at each vertex, [N].
        planes: found on this mesh.
        reach: maximum distance from a plane, in ground pixels; vertices of its own faces count at any distance.
        rings: maximum number of edges from a plane's own vertices.
    """
    count = len(planes.normals)
    labelled = np.flatnonzero(planes.label >= 0)
    keys = distinct((mesh.faces[labelled].astype(np.int64) * count + planes.label[labelled, None]).ravel())
    start, neighbour = mesh.adjacency.neighbours()
    added = keys
    for _ in range(rings):
        vertex, plane = np.divmod(added, count)
        times = start[vertex + 1] - start[vertex]
        new, of = neighbour[join_ranges(start[vertex], times)], np.repeat(plane, times)
        close = np.abs(planes.distances(mesh.vertices[new], of)) <= reach * pixel[new]
        wanted = distinct(new[close] * count + of[close])
        known = keys[np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)] == wanted
        added = wanted[~known]
        if not len(added):
            break
        keys = np.sort(np.concatenate([keys, added]))
    return NearPlanes(*np.divmod(keys, count))


def join_ranges(begin: NDArray[np.integer], times: NDArray[np.integer]) -> Index:
    """Return ``begin[i], begin[i] + 1, ...``, ``times[i]`` of them for each i, one after the other."""
    return np.asarray(np.repeat(begin - np.r_[0, np.cumsum(times)[:-1]], times) + np.arange(times.sum()), np.int64)
