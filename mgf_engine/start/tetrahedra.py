# SPDX-License-Identifier: GPL-3.0-or-later
"""Delaunay tetrahedra with what the kernels that walk through them need: neighbours, planes and corners."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Corners of the face opposite of each corner, outward: the tetrahedra have positive volume.
FACE_CORNERS = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Tetrahedra:
    """Tetrahedra of positive volume: ``corners`` [T, 4] number the ``points`` [N, 3]."""

    points: Array
    corners: NDArray[np.int32]

    @cached_property
    def neighbours(self) -> NDArray[np.int32]:
        """Tetrahedra opposite of each corner, -1 at the rim, [T, 4]."""
        return face_neighbours(self.corners, len(self.points))

    @cached_property
    def planes(self) -> Array:
        """Outward unit normals and offsets of the faces, [T, 4, 4]."""
        result = np.empty((len(self.corners), 4, 4))
        for k, corners in enumerate(FACE_CORNERS):
            a, b, c = (self.points[self.corners[:, n]] for n in corners)
            n = np.cross(b - a, c - a)
            n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-300)
            result[:, k, :3], result[:, k, 3] = n, -(n * a).sum(1)
        return result

    @cached_property
    def volumes(self) -> Array:
        """Volumes [T]."""
        a, b, c, d = (self.points[self.corners[:, k]] for k in range(4))
        return np.asarray(np.abs(np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a)) / 6)

    @cached_property
    def table(self) -> Any:
        """The ``struct Tetrahedra`` of ``native/csrc/mesh/tetra_rays.c``; it keeps its arrays alive."""
        flat = self.corners.ravel()
        order = np.argsort(flat, kind="stable")
        around = np.searchsorted(flat[order], np.arange(len(self.points) + 1)).astype(np.int64)
        arrays = self.corners, self.neighbours, self.planes, self.points, around, (order // 4).astype(np.int32)
        names = ("corner", "neighbour", "plane", "points", "around", "list")
        kinds = [*((name, ctypes.c_void_p) for name in names), ("count", ctypes.c_int64)]
        table = type("TetraTable", (ctypes.Structure,), {"_fields_": kinds})(
            *(a.ctypes.data for a in arrays), len(self.corners)
        )
        table.arrays = arrays
        return table

    @property
    def reference(self) -> ctypes.c_void_p:
        """The table's address."""
        return ctypes.c_void_p(ctypes.addressof(self.table))


def face_neighbours(corners: NDArray[np.int32], points: int) -> NDArray[np.int32]:
    """Find the tetrahedron beyond each face, which is opposite of a corner.

    Args:
        corners: of the tetrahedra, [T, 4].
        points: number of points.

    Returns:
        Numbers of tetrahedra, -1 for none, [T, 4].
    """
    faces = np.sort(corners[:, FACE_CORNERS].reshape(-1, 3).astype(np.int64), axis=1)
    key = (faces[:, 0] * points + faces[:, 1]) * points + faces[:, 2]
    if points**3 >= 2**63:
        key = np.unique(faces, axis=0, return_inverse=True)[1].ravel()
    order = np.argsort(key, kind="stable")
    twin = np.flatnonzero(key[order[1:]] == key[order[:-1]])
    result = np.full(len(key), -1, np.int32)
    first, second = order[twin], order[twin + 1]
    result[first], result[second] = second // 4, first // 4
    return result.reshape(-1, 4)


def orient_positive(points: Array, corners: NDArray[np.int32]) -> NDArray[np.int32]:
    """Turn tetrahedra [T, 4] that all have the same sense so that their volumes are positive.

    The sum of the volumes decides for all: the sign of a flat one's volume is that of its rounding error.
    """
    a, b, c, d = (points[corners[:, k]] for k in range(4))
    total = np.einsum("ij,ij->", np.cross(b - a, c - a), d - a)
    return np.ascontiguousarray(corners if total > 0 else corners[:, [0, 1, 3, 2]])
