# SPDX-License-Identifier: GPL-3.0-or-later
"""Clean a mesh: weld vertices, remove degenerate faces and false components, orient, smooth, make it a manifold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.morton import arrange, cells_of, morton
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.topology import half_edges
from mgf_engine.native.parallel import parallel_map

DRAWN_BACK = 0.01  # weight of the neighbours' mean in Laplacian smoothing
CHUNK = 1 << 15  # faces that are measured at a time
SEEN_PIXELS = 3  # parts of which all views together see fewer pixels are dropped


def face_areas(mesh: Mesh) -> NDArray[np.float64]:
    """Compute the areas of the faces, [F]."""

    def some(start: int) -> NDArray[np.float64]:
        a, b, c = (mesh.vertices[mesh.faces[start : start + CHUNK, k]] for k in range(3))
        return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))

    return np.concatenate([np.zeros(0), *parallel_map(some, range(0, len(mesh.faces), CHUNK))])


def vertex_areas(mesh: Mesh) -> NDArray[np.float64]:
    """Return a third of the area of the faces around each vertex, [N]."""
    shares = np.repeat(face_areas(mesh) / 3, 3)
    return np.asarray(np.bincount(mesh.faces.ravel(), shares, len(mesh.vertices)), np.float64)


def with_faces(mesh: Mesh, faces: NDArray[np.int32]) -> Mesh:
    """Return the mesh with these faces, without unused vertices."""
    used = np.zeros(len(mesh.vertices), bool)
    used[faces.ravel()] = True
    index = np.cumsum(used, dtype=np.int32) - np.int32(1)
    return mesh.gather(np.flatnonzero(used), index[faces.reshape(-1, 3)])


def weld(mesh: Mesh) -> Mesh:
    """Merge vertices at the same position; remove degenerate and repeated faces.

    Vertices and faces are sorted in Morton order.
    """
    if len(mesh.vertices) == 0:
        return mesh
    order, new = arrange(morton(cells_of(mesh.vertices)), *mesh.vertices.T)
    group = np.empty(len(order), np.int32)
    group[order] = np.cumsum(new) - 1
    faces = group[mesh.faces]
    proper = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    faces = faces[proper]
    a, b, c = np.sort(faces, 1).T.astype(np.uint64)
    by_place, once = arrange(a << np.uint64(32) | b, c)
    return with_faces(mesh.gather(order[new], faces), faces[by_place[once]])


def parts(mesh: Mesh) -> NDArray[np.int32]:
    """Label the connected parts (by shared edges) of the faces, int32 [F]."""
    return mesh.adjacency.parts()


def large_parts(mesh: Mesh, share: float) -> NDArray[np.bool_]:
    """Find the faces of parts whose area is at least ``share`` of the largest part's, bool [F]."""
    label = parts(mesh)
    area = np.bincount(label, weights=face_areas(mesh))
    large: NDArray[np.bool_] = area >= share * area.max(initial=0.0)
    return large[label]


def seen_parts(mesh: Mesh, seen: NDArray[np.integer], share: float) -> NDArray[np.bool_]:
    """Find the faces of components that are visible, bool [F]; removes bubbles inside walls and distant objects.

    Args:
        mesh: of any frame.
        seen: number of pixels of all views together that show each face, [F].
        share: minimum number of pixels of a component, as a share of that with the most pixels.
    """
    label = parts(mesh)
    pixels = np.bincount(label, weights=seen)
    visible: NDArray[np.bool_] = pixels >= max(SEEN_PIXELS, share * pixels.max(initial=0))
    return visible[label]


def unconfirmed_patches(
    mesh: Mesh, confirmed: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float64]]:
    """Find faces without a confirmed vertex (bool [N]): their rows [K], the patch of each [K], and the patches'
    areas."""
    rows = np.flatnonzero(~confirmed[mesh.faces].any(1))
    patch = replace(mesh, faces=mesh.faces[rows])
    label = parts(patch)
    return rows, label, np.asarray(np.bincount(label, weights=face_areas(patch)), np.float64)


def drop_unconfirmed(mesh: Mesh, confirmed: NDArray[np.bool_], largest: float) -> Mesh:
    """Drop patches that no view shows, such as a skirt below the building; small ones stay and close holes.

    Args:
        confirmed: bool [N], vertices near which a view shows a surface.
        largest: share of the mesh's area up to which such a patch may stay.
    """
    made_up, patch, area = unconfirmed_patches(mesh, confirmed)
    if not len(made_up):
        return mesh
    too_large = area > largest * face_areas(mesh).sum()
    return with_faces(mesh, np.delete(mesh.faces, made_up[too_large[patch]], axis=0))


def smooth(mesh: Mesh, rounds: int) -> Mesh:
    """Move every vertex half way to the mean of its neighbours, ``rounds`` times; open rims stay where they are."""
    if rounds <= 0 or len(mesh.faces) == 0:
        return mesh
    fixed, vertices = border_vertices(mesh), np.ascontiguousarray(mesh.vertices)
    for _ in range(rounds):
        vertices = mesh.adjacency.smooth(vertices, fixed)
    return replace(mesh, vertices=vertices)


def orient_outward(mesh: Mesh, front: NDArray[np.integer], back: NDArray[np.integer]) -> Mesh:
    """Flip the components that are seen mostly from behind; ``front``, ``back``: pixels that show each face, [F]."""
    if len(mesh.faces) == 0:
        return mesh
    label = parts(mesh)
    wrong = np.bincount(label, weights=back) > np.bincount(label, weights=front)
    if not wrong.any():
        return mesh
    faces = mesh.faces.copy()
    faces[wrong[label]] = faces[wrong[label]][:, ::-1]
    return replace(mesh, faces=faces)


def split_nonmanifold(mesh: Mesh) -> Mesh:
    """Cut the mesh open where more than two faces share an edge or two fans share a vertex.

    The first fan around a vertex keeps it, each further one gets a copy (after Gueziec et al. 2001). Both draw back a
    little into their own faces, or whoever joins vertices by place would undo the cut.
    """
    fan, fans = mesh.adjacency.fans()
    further = np.maximum(fans - 1, 0)
    copies = len(fans) + np.cumsum(further) - further  # the first copy of each vertex
    moved = np.flatnonzero(fan)
    faces = mesh.faces.ravel().copy()
    corner = mesh.adjacency.corner[moved]
    faces[corner] = copies[faces[corner]] + fan[moved] - 1
    origin = np.r_[np.arange(len(fans)), np.repeat(np.arange(len(fans)), further)]
    cut = mesh.gather(origin, faces.reshape(-1, 3))
    if not further.any():
        return cut
    halfway = cut.adjacency.smooth(np.ascontiguousarray(cut.vertices), fans[origin] < 2)
    return replace(cut, vertices=cut.vertices + DRAWN_BACK * (halfway - cut.vertices))


def edge_keys(faces: NDArray[np.integer]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return an undirected key for each of the three edges of each face [3 F], and the face it belongs to."""
    a, b = half_edges(faces).T
    key = np.minimum(a, b) << 32 | np.maximum(a, b)
    return key, np.repeat(np.arange(len(faces)), 3)


def face_neighbours(faces: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return pairs of faces that share an edge, [E, 2]."""
    key, owner = edge_keys(faces)
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(np.diff(key[order]) == 0)
    return np.stack([owner[order[same]], owner[order[same + 1]]], 1)


def open_edges(mesh: Mesh) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return edges with one face only, in the direction of that face."""
    alone = mesh.adjacency.open_edges()
    return mesh.faces[alone], np.roll(mesh.faces, -1, axis=1)[alone]


def border_vertices(mesh: Mesh) -> NDArray[np.bool_]:
    """Find the vertices that lie on an open edge, bool [N]."""
    border = np.zeros(len(mesh.vertices), bool)
    border[np.concatenate(open_edges(mesh))] = True
    return border
