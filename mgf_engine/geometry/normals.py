# SPDX-License-Identifier: GPL-3.0-or-later
"""Unit vectors, and normals of points, faces and vertices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mgf_engine.model.mesh import Mesh


def unit_vectors(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Scale vectors [..., 3] to length 1; those of no length stay 0."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30), np.float64)


def principal_normals(points: NDArray[np.float64], neighbours: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the direction of least spread among the neighbours of each point, by principal components; of either sign.

    Args:
        points: [P, 3].
        neighbours: rows of ``points``, [N, K].

    Returns:
        unit vectors [N, 3].
    """
    around = points[neighbours]
    offsets = around - around.mean(1, keepdims=True)
    _, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets))
    return np.asarray(vectors[:, :, 0], np.float64)


def face_cross_products(vertices: NDArray[np.float64], faces: NDArray[np.integer]) -> NDArray[np.float64]:
    """Compute the cross products of two edges of each face, [F, 3]: normals as long as twice the face's area.

    Args:
        vertices: [N, 3].
        faces: vertex indices, [F, 3].
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def vertex_normals(mesh: Mesh) -> NDArray[np.float64]:
    """Compute unit normals of the vertices [N, 3]: mean of the adjacent faces, weighted by their area."""
    total = mesh.adjacency.vertex_normals(mesh.vertices)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return total / np.where(length > 0, length, 1.0)
