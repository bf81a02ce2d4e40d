# SPDX-License-Identifier: GPL-3.0-or-later
"""Project nearly planar regions of a mesh onto their planes.

A vertex within three times the noise of its plane, and at most a ground pixel, is projected onto it; up to twice that
distance it moves by a share. A vertex between two planes moves onto their crease, between three into their corner.
Vertices farther away do not move.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgf_engine.mesh.near_planes import join_ranges, near_planes
from mgf_engine.mesh.planar_options import PlanarOptions
from mgf_engine.mesh.plane_borders import undo_folds
from mgf_engine.mesh.plane_detection import PARALLEL, MeshFaces, Plane, Planes, find_planes, measure_faces
from mgf_engine.mesh.relief import Relief
from mgf_engine.model.mesh import Mesh


class Flattened(NamedTuple):
    """A flattened mesh.

    Attributes:
        mesh: with planar parts projected; other vertices are where they were.
        planes: None where there are none.
        inside: which vertices lie in their plane, crease or corner, bool [N].
        plane: the plane of those that lie in one alone, int32 [N], -1 for others.
    """

    mesh: Mesh
    planes: Planes | None
    inside: NDArray[np.bool_]
    plane: NDArray[np.int32]


def flatten(mesh: Mesh, pixel: NDArray[np.floating], options: PlanarOptions = PlanarOptions()) -> Mesh:
    """Project the planar parts of a mesh onto their planes; no face comes, goes or turns over.

    Args:
        pixel: size of a ground pixel at each vertex, in the mesh's units, [N].
    """
    return flatten_planes(mesh, pixel, options).mesh


def flatten_planes(
    mesh: Mesh,
    pixel: NDArray[np.floating],
    options: PlanarOptions = PlanarOptions(),
    relief: Relief | None = None,
    known: Sequence[Plane] = (),
) -> Flattened:
    """Flatten as :func:`flatten` does; return also the planes.

    Args:
        mesh: of any frame.
        pixel: size of a ground pixel at each vertex, in the mesh's units, [N].
        options: of the planes.
        relief: keeps what stands out of a plane together; None keeps nothing within noise.
        known: planes of either side that replace those found on the mesh where they hold more of it.
    """
    count = len(mesh.vertices)
    nothing = Flattened(mesh, None, np.zeros(count, bool), np.full(count, -1, np.int32))
    if len(mesh.faces) == 0 or not (np.asarray(pixel) > 0).all():
        return nothing
    size: NDArray[np.float64] = np.asarray(pixel, np.float64)
    faces = measure_faces(mesh, size, options)
    planes = find_planes(faces, options, known)
    if len(planes.normals) == 0:
        return nothing
    near = near_planes(mesh, size, planes, options.band, options.rings)
    label = _label_creases(mesh, faces, planes, near.vertex, near.plane, options)
    moves, inside, plane = _moves(mesh, size, planes, label, near.vertex, options, relief)
    whole = np.where(inside[mesh.faces].all(1), label, -1)
    moved, kept = undo_folds(mesh, mesh.vertices, mesh.vertices + moves, planes, whole)
    return Flattened(replace(mesh, vertices=moved), planes, inside & kept, np.where(kept, plane, -1))


def _label_creases(
    mesh: Mesh,
    faces: MeshFaces,
    planes: Planes,
    vertex: NDArray[np.int64],
    plane: NDArray[np.int64],
    options: PlanarOptions,
) -> NDArray[np.int32]:
    """Return the plane of each face, int32 [F]; faces along creases get the nearest of their planes."""
    corner = mesh.adjacency.corner
    start = mesh.adjacency.start.astype(np.int64)
    times = (start[1:] - start[:-1])[vertex]
    rows = join_ranges(start[vertex], times)
    key, shared = np.unique((corner[rows] // 3).astype(np.int64) * len(planes.normals) + np.repeat(plane, times),
                            return_counts=True)  # fmt: skip
    face, of = np.divmod(key[shared == 3], len(planes.normals))
    label = planes.label.copy()
    several = (np.bincount(face, minlength=len(label)) > 1)[face]
    face, of = face[several], of[several]
    off = np.abs(planes.distances(faces.centre[face], of))
    order = np.lexsort((off, face))
    face, of = face[order], of[order]
    first = np.r_[True, face[1:] != face[:-1]][: len(face)]
    second = np.flatnonzero(first) + 1  # every face here has two planes at least
    cosine = np.einsum("ij,ij->i", planes.normals[of[first]], planes.normals[of[second]])
    meet = cosine < np.cos(np.radians(options.crease))
    label[face[first][meet]] = of[first][meet]
    return label


def _moves(
    mesh: Mesh,
    pixel: NDArray[np.float64],
    planes: Planes,
    label: NDArray[np.int32],
    near: NDArray[np.int64],
    options: PlanarOptions,
    relief: Relief | None,
) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.int32]]:
    """Return the shortest way of each vertex into the planes of its faces, [N, 3], none where it is too far.

    Also return which vertices go the whole way, bool [N], and into which plane those with one go, int32 [N], else -1.
    """
    total = len(pixel)
    vertex, plane = _planes_at_vertices(mesh, label, len(planes.normals))
    off = planes.distances(mesh.vertices[vertex], plane)
    several = np.bincount(near, minlength=total) > 1
    noise = np.minimum(options.sigmas * planes.noise[plane], options.band)
    reach = np.where(several[vertex], options.band, noise) * pixel[vertex]
    times = np.bincount(vertex, minlength=total)
    one = times[vertex] == 1
    # A fixed vertex next to a moved one would make a step: vertices a little farther away move by a share.
    share = np.clip(2 - np.abs(off) / np.maximum(reach, 1e-300), 0, 1)
    far = times > 3
    far[vertex[~one & (np.abs(off) > reach)]] = True
    if relief is not None:
        off[one] -= relief.heights(mesh, pixel, planes, vertex[one], plane[one])
    moves = np.zeros((total, 3))
    moves[vertex[one]] = -(share * off)[one, None] * planes.normals[plane[one]]
    more = ~one & ~far[vertex]
    on_crease, moves_to_crease = _moves_to_creases(planes, vertex[more], plane[more], off[more])
    moves[on_crease] = moves_to_crease
    far |= np.linalg.norm(moves, axis=1) > np.where(times > 1, options.crease_move, options.band) * pixel
    moves[far] = 0
    alone = one & (share == 1) & ~far[vertex]
    own = np.full(total, -1, np.int32)
    own[vertex[alone]] = plane[alone]
    inside = own >= 0
    inside[on_crease] = ~far[on_crease]
    return moves, inside, own


def _planes_at_vertices(
    mesh: Mesh, label: NDArray[np.int32], count: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the pairs [K] of a vertex and one of the ``count`` planes of its faces, ordered by vertex."""
    labelled = np.flatnonzero(label >= 0)
    key = np.unique(mesh.faces[labelled].astype(np.int64) * count + label[labelled, None])
    return np.divmod(key, count)


def _moves_to_creases(
    planes: Planes, vertex: NDArray[np.int64], plane: NDArray[np.int64], off: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return vertices of two or three planes, [V], and their shortest moves onto the crease or corner of these, [V, 3].

    Args:
        planes: found on the mesh.
        vertex: of each pair of a vertex and a plane, ascending, [K].
        plane: of each pair, [K].
        off: distance of the vertex from the plane, [K].
    """
    rows, first, at = np.unique(vertex, return_index=True, return_inverse=True)
    if not len(rows):
        return rows, np.zeros((0, 3))
    place = np.arange(len(vertex)) - first[at]
    normals, distances = np.zeros((len(rows), 3, 3)), np.zeros((len(rows), 3))
    normals[at, place], distances[at, place] = planes.normals[plane], -off
    return rows, np.einsum("nij,nj->ni", np.linalg.pinv(normals, rcond=PARALLEL), distances)
