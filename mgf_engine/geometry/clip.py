# SPDX-License-Identifier: GPL-3.0-or-later
"""Clip a mesh at planes, or at the zero level of a function of its vertices; new vertices are shared by both faces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.clean import with_faces
from mgf_engine.model.mesh import Mesh


def clip(mesh: Mesh, planes: NDArray[np.float64]) -> Mesh:
    """Cut a mesh to the inner side of every plane; cuts stay open.

    Args:
        planes: [K, 4]; a point p is inside when ``n . p + d >= 0``.
    """
    for plane in planes:
        mesh = _clip_one(mesh, plane)
    return mesh


def _clip_one(mesh: Mesh, plane: NDArray[np.float64]) -> Mesh:
    return clip_level(mesh, mesh.vertices @ plane[:3] + plane[3])


def clip_level(mesh: Mesh, side: NDArray[np.float64]) -> Mesh:
    """Cut a mesh to where a function of its vertices [N], linear in its faces, is not negative; cuts stay open.

    Where the function is zero at a corner, faces may come out with two corners at one place.
    """
    inside = side >= 0
    count = inside[mesh.faces].sum(1)
    if (count == 3).all():
        return mesh
    one, two = (_turned(mesh.faces[count == k], inside == (k == 1)) for k in (1, 2))
    # One corner inside: a triangle a, ab, ac. Two inside (a is the one outside): the quad ab, b, c, ac.
    cut = np.concatenate([one[:, [0, 1]], one[:, [0, 2]], two[:, [0, 1]], two[:, [0, 2]]])
    mesh, index = _with_cuts(mesh, side, cut)
    n, m = len(one), len(two)
    ab, ac, qb, qc = np.split(index, [n, 2 * n, 2 * n + m])
    faces = np.concatenate([
        mesh.faces[count == 3],
        np.column_stack([one[:, 0], ab, ac]),
        np.column_stack([qb, two[:, 1], two[:, 2]]),
        np.column_stack([qb, two[:, 2], qc]),
    ])  # fmt: skip
    return with_faces(mesh, faces.astype(np.int32))


def _turned(faces: NDArray[np.int32], lone: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Return faces [F, 3] turned so that the one corner of which ``lone`` holds comes first; the orientation stays."""
    first = np.argmax(lone[faces], axis=1)
    return faces[np.arange(len(faces))[:, None], (first[:, None] + np.arange(3)) % 3]


def _with_cuts(mesh: Mesh, side: NDArray[np.float64], cut: NDArray[np.int32]) -> tuple[Mesh, NDArray[np.int64]]:
    """Return the mesh with a vertex where each edge of ``cut`` [C, 2] crosses zero, and the index of each, [C].

    Colours are those between the ends, values those of the nearer end (they may be counts or labels).
    """
    edges, index = np.unique(np.sort(cut, 1), axis=0, return_inverse=True)
    a, b = edges[:, 0], edges[:, 1]
    share = (side[a] / (side[a] - side[b]))[:, None]
    nearer = np.where(share[:, 0] < 0.5, a, b)
    vertices = mesh.vertices[a] + share * (mesh.vertices[b] - mesh.vertices[a])
    colors = np.rint(mesh.colors[a] + share * (mesh.colors[b].astype(np.float64) - mesh.colors[a])).astype(np.uint8)
    values = {name: np.concatenate([value, value[nearer]]) for name, value in mesh.values.items()}
    whole = Mesh(np.concatenate([mesh.vertices, vertices]), mesh.faces, np.concatenate([mesh.colors, colors]), values)
    return whole, index.reshape(-1) + len(mesh.vertices)
