# SPDX-License-Identifier: GPL-3.0-or-later
"""Pairs of a vertex and a plane that it is near, and places in those planes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mgf_engine.mesh.plane_detection import Planes
from mgf_engine.model.mesh import Mesh

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
    keys = np.unique(mesh.faces[labelled].astype(np.int64) * count + planes.label[labelled, None])
    start, end = mesh.faces.ravel(), np.roll(mesh.faces, -1, axis=1).ravel()
    for _ in range(rings):
        # only vertices beside a part without plane, or of another one, pass theirs on
        vertex, plane = np.divmod(keys, count)
        several = np.bincount(vertex, minlength=len(pixel))
        begin = np.searchsorted(vertex, np.arange(len(pixel)))
        first = np.where(several > 0, plane[np.minimum(begin, len(plane) - 1)], -1)
        apart = (first[start] != first[end]) | (several[start] != several[end])
        a, b = (np.r_[start[apart], end[apart]], np.r_[end[apart], start[apart]])
        rows = listed(begin[a], several[a])
        new, of = np.repeat(b, several[a]), plane[rows]
        close = np.abs(planes.distances(mesh.vertices[new], of)) <= reach * pixel[new]
        keys = np.union1d(keys, new[close].astype(np.int64) * count + of[close])
    return NearPlanes(*np.divmod(keys, count))


def listed(begin: NDArray[np.integer], times: NDArray[np.integer]) -> Index:
    """Return ``begin[i], begin[i] + 1, ...``, ``times[i]`` of them for each i, one after the other."""
    return np.asarray(np.repeat(begin - np.r_[0, np.cumsum(times)[:-1]], times) + np.arange(times.sum()), np.int64)
