# SPDX-License-Identifier: GPL-3.0-or-later
"""From the raw level set to a clean mesh: faces without area, false parts, orientation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from mgf_engine.mesh.model import Mesh
from mgf_engine.mesh.view import face_normals, look, pixel_rays
from mgf_engine.scene.model import View

SEEN_PIXELS = 3  # parts of which all views together see fewer pixels are dropped


def face_areas(mesh: Mesh) -> NDArray[np.float64]:
    """Areas [F]."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    areas: NDArray[np.float64] = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return areas


def vertex_areas(mesh: Mesh) -> NDArray[np.float64]:
    """A third of the area of the faces around each vertex, [N]."""
    shares = np.repeat(face_areas(mesh) / 3, 3)
    return np.asarray(np.bincount(mesh.faces.ravel(), shares, len(mesh.vertices)), np.float64)


def with_faces(mesh: Mesh, faces: NDArray[np.int32]) -> Mesh:
    """The mesh of these faces, without vertices they do not use."""
    used, index = np.unique(faces, return_inverse=True)
    return mesh.gather(used, index.reshape(-1, 3))


def weld(mesh: Mesh) -> Mesh:
    """Vertices at one place become one; faces with two equal corners and repeated faces go."""
    _, first, group = np.unique(mesh.vertices, axis=0, return_index=True, return_inverse=True)
    faces = group.reshape(-1)[mesh.faces].astype(np.int32)
    proper = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    faces = faces[proper]
    _, once = np.unique(np.sort(faces, 1), axis=0, return_index=True)
    return with_faces(mesh.gather(first, faces), faces[np.sort(once)])


def parts(mesh: Mesh) -> NDArray[np.int32]:
    """Which connected part (by shared edges) each face belongs to, int32 [F]."""
    count = len(mesh.faces)
    if count == 0:
        return np.zeros(0, np.int32)
    edge, face = edges(mesh.faces)
    order = np.argsort(edge, kind="stable")
    same = edge[order][1:] == edge[order][:-1]
    a, b = face[order][1:][same], face[order][:-1][same]
    graph = coo_matrix((np.ones(len(a), np.int8), (a, b)), shape=(count, count))
    label: NDArray[np.int32] = connected_components(graph, directed=False)[1].astype(np.int32)
    return label


def drop_small_parts(mesh: Mesh, share: float) -> Mesh:
    """Keep the parts whose area is at least ``share`` of the largest part's."""
    if len(mesh.faces) == 0:
        return mesh
    label = parts(mesh)
    area = np.bincount(label, weights=face_areas(mesh))
    return with_faces(mesh, mesh.faces[(area >= share * area.max())[label]])


def drop_hidden_parts(mesh: Mesh, seen: NDArray[np.int64], share: float) -> Mesh:
    """Drop parts that the views hardly see: bubbles inside walls, and far things that few masks let in.

    Args:
        seen: pixels of all views together that see each face, int64 [F].
        share: of the pixels of the part that is seen most; parts with less are dropped.
    """
    if len(mesh.faces) == 0:
        return mesh
    label = parts(mesh)
    pixels = np.bincount(label, weights=seen)
    visible = pixels >= max(SEEN_PIXELS, share * pixels.max())
    return with_faces(mesh, mesh.faces[visible[label]])


def drop_unconfirmed(mesh: Mesh, confirmed: NDArray[np.bool_], largest: float) -> Mesh:
    """Drop patches that no view shows, such as a skirt below the building; small ones stay and close holes.

    Args:
        confirmed: bool [N], vertices near which a view shows a surface.
        largest: share of the mesh's area up to which such a patch may stay.
    """
    made_up = ~confirmed[mesh.faces].any(1)
    if not made_up.any():
        return mesh
    patch = replace(mesh, faces=mesh.faces[made_up])
    label, areas = parts(patch), face_areas(patch)
    too_large = (np.bincount(label, weights=areas) > largest * face_areas(mesh).sum())[label]
    keep = np.ones(len(mesh.faces), bool)
    keep[np.flatnonzero(made_up)[too_large]] = False
    return with_faces(mesh, mesh.faces[keep])


def smooth(mesh: Mesh, rounds: int) -> Mesh:
    """Move every vertex half way to the mean of its neighbours, ``rounds`` times; open rims stay where they are."""
    if rounds <= 0 or len(mesh.faces) == 0:
        return mesh
    count = len(mesh.vertices)
    a, b = mesh.faces.ravel(), np.roll(mesh.faces, -1, axis=1).ravel()
    links = coo_matrix((np.ones(2 * len(a), np.float64), (np.r_[a, b], np.r_[b, a])), shape=(count, count)).tocsr()
    links.data[:] = 1.0
    degree = np.asarray(links.sum(1)).ravel()
    share = 0.5 / np.maximum(degree, 1)
    share[np.concatenate(open_edges(mesh.faces))] = 0.0
    vertices = mesh.vertices.copy()
    for _ in range(rounds):
        vertices += share[:, None] * (links @ vertices - degree[:, None] * vertices)
    return replace(mesh, vertices=vertices)


def orient_outward(mesh: Mesh, front: NDArray[np.int64], back: NDArray[np.int64]) -> Mesh:
    """Turn the parts that the cameras see mostly from behind. ``front``, ``back``: pixels of each face."""
    if len(mesh.faces) == 0:
        return mesh
    label = parts(mesh)
    wrong = np.bincount(label, weights=back) > np.bincount(label, weights=front)
    faces = mesh.faces.copy()
    faces[wrong[label]] = faces[wrong[label]][:, ::-1]
    return replace(mesh, faces=faces)


def count_pixels(mesh: Mesh, views: Sequence[View]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pixels of all views together that see each face from the front and from behind, int64 [F] each."""
    front, back = np.zeros((2, len(mesh.faces)), np.int64)
    normals = face_normals(mesh)
    facing: NDArray[np.bool_]
    for view in views:
        sight = look(mesh, view)
        rows, columns = np.nonzero(sight.face >= 0)
        faces = sight.face[rows, columns]
        facing = (normals[faces] * pixel_rays(view, rows, columns)).sum(1) < 0
        front += np.bincount(faces[facing], minlength=len(front))
        back += np.bincount(faces[~facing], minlength=len(back))
    return front, back


def split_nonmanifold(mesh: Mesh) -> Mesh:
    """Cut the mesh open where more than two faces share an edge or two fans share a vertex."""
    import igl

    if len(mesh.faces) == 0:
        return mesh
    faces, origin = igl.split_nonmanifold(np.ascontiguousarray(mesh.faces, dtype=np.int64))[:2]
    return mesh.gather(origin, faces)


def edges(faces: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """An undirected key for each of the three edges of each face [3 F], and the face it belongs to."""
    a, b = faces.ravel().astype(np.int64), np.roll(faces, -1, axis=1).ravel().astype(np.int64)
    key = np.minimum(a, b) << 32 | np.maximum(a, b)
    return key, np.repeat(np.arange(len(faces)), 3)


def open_edges(faces: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Edges with one face only, in the direction of that face."""
    key = edges(faces)[0]
    _, inverse, counts = np.unique(key, return_inverse=True, return_counts=True)
    single = counts[inverse] == 1
    a, b = faces.ravel().astype(np.int64), np.roll(faces, -1, axis=1).ravel().astype(np.int64)
    return a[single], b[single]
