# SPDX-License-Identifier: GPL-3.0-or-later
"""Delaunay tetrahedra with what the kernels that walk through them need: neighbours and corners."""

from __future__ import annotations

import contextlib
import ctypes
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mgf_engine.native.library import by_reference, call, parallel

#: Corners of the face opposite of each corner, outward: the tetrahedra have positive volume.
FACE_CORNERS = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
_CHUNK = 1 << 17  # tetrahedra that are processed at a time, which bounds the memory

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Tetrahedra:
    """Tetrahedra of positive volume: ``corners`` [T, 4] number the ``points`` [N, 3]."""

    points: Array
    corners: NDArray[np.int32]

    def around(self) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
        """List the tetrahedra around each point (kernel ``mgf_tetra_around``).

        Returns:
            ``first`` [N + 1] and ``listed`` [4 T]: those of point n are ``listed[first[n]:first[n + 1]]``.
        """
        first, listed = np.empty(len(self.points) + 1, np.int64), np.empty(self.corners.size, np.int32)
        call("mgf_tetra_around", len(self.corners), self.corners, len(self.points), first, listed)
        return first, listed

    @cached_property
    def neighbours(self) -> NDArray[np.int32]:
        """Tetrahedra beyond the face opposite of each corner, -1 for none, [T, 4] (kernel ``mgf_tetra_neighbours``)."""
        result = np.empty_like(self.corners)
        parallel("mgf_tetra_neighbours", len(result), self.corners, *self.around(), result)
        return result

    def volumes(self, chunk: slice) -> Array:
        """Compute the volumes of the tetrahedra of a chunk, [B]."""
        a, b, c, d = (self.points[self.corners[chunk, k]] for k in range(4))
        return np.asarray(np.abs(np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a)) / 6)

    def chunks(self) -> Iterator[slice]:
        """Yield slices of the tetrahedra that are processed at a time, which bounds the memory."""
        for begin in range(0, len(self.corners), _CHUNK):
            yield slice(begin, min(begin + _CHUNK, len(self.corners)))

    @contextlib.contextmanager
    def kernel_table(self, from_points: bool = False) -> Iterator[ctypes.c_void_p]:
        """Provide a ``struct Tetrahedra`` to kernels that walk rays through them, in the body of a ``with`` statement.

        Args:
            from_points: whether the rays begin at points; the kernel then needs the tetrahedra around each.
        """
        around, listed = self.around() if from_points else (np.zeros(0, np.int64), np.zeros(0, np.int32))
        table = TetraTable(self.corners, self.neighbours, self.points, around, listed)
        yield by_reference(table)


class TetraTable(ctypes.Structure):
    """``struct Tetrahedra`` of ``native/csrc/mesh/tetra_rays.c``, which holds addresses only; keeps their arrays."""

    _fields_ = [
        *((name, ctypes.c_void_p) for name in ("corner", "neighbour", "points", "around", "list")),
        ("count", ctypes.c_int64),
    ]

    def __init__(self, *arrays: NDArray[np.generic]) -> None:
        super().__init__(*(a.ctypes.data for a in arrays), len(arrays[0]))
        self.arrays = arrays


def orient_positive(points: Array, corners: NDArray[np.int32]) -> NDArray[np.int32]:
    """Turn tetrahedra [T, 4] that all have the same sense so that their volumes are positive.

    The sum of the volumes decides for all: the sign of a flat one's volume is that of its rounding error.
    """
    total = 0.0
    for begin in range(0, len(corners), _CHUNK):
        a, b, c, d = (points[corners[begin : begin + _CHUNK, k]] for k in range(4))
        total += float(np.einsum("ij,ij->", np.cross(b - a, c - a), d - a))
    return np.ascontiguousarray(corners if total > 0 else corners[:, [0, 1, 3, 2]])
