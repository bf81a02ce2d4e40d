# SPDX-License-Identifier: GPL-3.0-or-later
"""Subdivide the long edges of a mesh at their middles; shape and topology are preserved."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mgf_engine.model.topology import half_edges

#: Which corners and middles (3: of the edge 0-1, 4: 1-2, 5: 2-0) make the new faces, by the edges divided (bits).
_PATTERNS = {
    0: [(0, 1, 2)], 1: [(0, 3, 2), (3, 1, 2)], 2: [(0, 1, 4), (0, 4, 2)], 4: [(0, 1, 5), (5, 1, 2)],
    3: [(3, 1, 4), (0, 3, 4), (0, 4, 2)], 6: [(4, 2, 5), (0, 1, 4), (0, 4, 5)], 5: [(0, 3, 5), (3, 1, 2), (3, 2, 5)],
    7: [(0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)],
}  # fmt: skip


def divide_long_edges(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], longest: float
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.int64]]:
    """Divide the edges longer than ``longest``; returns vertices [M, 3], faces [G, 3] and the face each comes from [G].

    An edge that two faces share is divided in both, so that they stay neighbours.
    """
    origin = np.arange(len(faces))
    while len(faces):
        ends = np.sort(half_edges(faces), axis=1)
        long = np.linalg.norm(vertices[ends[:, 0]] - vertices[ends[:, 1]], axis=1) > longest
        if not long.any():
            break
        pairs, place = np.unique(ends[long], axis=0, return_inverse=True)
        middle = np.full(len(ends), -1, np.int64)
        middle[long] = len(vertices) + place.ravel()
        vertices = np.concatenate([vertices, vertices[pairs].mean(1)])
        six = np.concatenate([faces, middle.reshape(-1, 3)], axis=1)
        code = long.reshape(-1, 3) @ np.array([1, 2, 4])
        parts = [
            (six[code == bits][:, corners], origin[code == bits])
            for bits, pattern in _PATTERNS.items()
            for corners in pattern
        ]
        faces = np.concatenate([part for part, _ in parts]).astype(np.int32)
        origin = np.concatenate([own for _, own in parts])
    return vertices, faces, origin
