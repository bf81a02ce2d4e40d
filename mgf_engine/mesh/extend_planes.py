# SPDX-License-Identifier: GPL-3.0-or-later
"""Extend the planes of a mesh over dents and rounded edges unless the photos contradict.

Flattening (:mod:`mgf_engine.mesh.planar`) moves vertices by a ground pixel at most. Corners of plain walls are rounded
by more, and plain walls sink towards the panes of windows. Such vertices are labelled with a plane
(:mod:`mgf_engine.mesh.plane_labels`), projected onto it or onto the crease of two planes, and then smoothed within it,
which unfolds overturned faces.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.clean import border_vertices
from mgf_engine.mesh.photo_consistency import PatchPhotos
from mgf_engine.mesh.planar import Flattened
from mgf_engine.mesh.plane_borders import PlaneBorderOptions, slope_steps, smooth_borders, undo_folds
from mgf_engine.mesh.plane_detection import PARALLEL, Planes
from mgf_engine.mesh.plane_label_options import PlaneLabelOptions
from mgf_engine.mesh.plane_labels import label_vertices
from mgf_engine.mesh.relief import Relief
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.topology import directed_edges
from mgf_engine.options.algorithms import parameter

Array = NDArray[np.float64]

#: Vertex attribute, uint8 [N]: 1 for vertices on an extended plane, which count as confirmed.
ON_PLANE = "on_plane"


@dataclass(frozen=True)
class PlaneExtensionOptions:
    """Options of moving labelled vertices."""

    labels: PlaneLabelOptions = PlaneLabelOptions()
    borders: PlaneBorderOptions = PlaneBorderOptions()
    angle: float = parameter(20.0, "Minimum angle between two planes that meet in an edge", "degrees")
    reach: float = parameter(3.0, "Maximum distance of a vertex from an edge or a corner, beyond that from its planes",
                             "ground px")  # fmt: skip
    rounds: int = parameter(50, "Number of rounds in which vertices slide within their planes")


def extend_planes(
    mesh: Mesh,
    flat: Flattened,
    pixel: Array,
    photos: PatchPhotos,
    options: PlaneExtensionOptions = PlaneExtensionOptions(),
    relief: Relief | None = None,
) -> Mesh:
    """Project the vertices labelled with a plane onto it, or onto the crease of two planes.

    Args:
        mesh: normalised frame.
        flat: the same with planar parts projected, where vertices without plane stay, and the planes found.
        pixel: size of a ground pixel at each vertex, [N].
        photos: what sees its vertices.
        options: costs, distances and rounds.
        relief: keeps what stands out of a plane together; None keeps nothing.

    Returns:
        The mesh with values ``ON_PLANE``.
    """
    planes = flat.planes
    if planes is None:
        return _marked(flat.mesh, np.zeros(len(pixel), bool))
    label = label_vertices(mesh, pixel, planes, photos, flat.plane, options.labels)
    some = np.flatnonzero(label >= 0)
    constraint = _constraints(mesh, pixel, planes, label, options)
    single = constraint.single(len(label))
    if relief is not None:
        constraint.raise_planes(np.flatnonzero(single), relief.heights(
            mesh, pixel, planes, np.flatnonzero(single), label[single].astype(np.int64)))  # fmt: skip
    at = flat.mesh.vertices.copy()
    at[some] = mesh.vertices[some]
    flattened, end = (label < 0) & (flat.plane >= 0), border_vertices(mesh)  # smoothing these would draw them in
    face_label, fixed = _face_labels(mesh, np.where(flattened, flat.plane, label)), (label < 0) | end
    at = _slide(mesh, constraint, constraint.project(at), fixed, options.rounds)
    # Curves of vertices that were only flattened lie in their plane already and stay in it.
    at, border = smooth_borders(mesh, at, face_label, (single | flattened) & ~end, constraint.project, options.borders)
    at = _slide(mesh, constraint, at, fixed | border, options.borders.smooth_rounds)
    at += slope_steps(mesh, pixel, planes, label, single, options.borders)
    at, kept = undo_folds(mesh, flat.mesh.vertices, at, planes, face_label)
    return _marked(replace(flat.mesh, vertices=at), (label >= 0) & kept)


def _marked(mesh: Mesh, on_plane: NDArray[np.bool_]) -> Mesh:
    """Return the mesh with values ``ON_PLANE``."""
    return replace(mesh, values={**mesh.values, ON_PLANE: on_plane.astype(np.uint8)})


def _slide(mesh: Mesh, constraint: _Constraints, at: Array, fixed: NDArray[np.bool_], rounds: int) -> Array:
    """Smooth vertices [N, 3] within their planes, all but the ``fixed`` [N]."""
    for _ in range(rounds):
        at = constraint.project(mesh.adjacency.smooth(np.ascontiguousarray(at), fixed))
    return at


def _face_labels(mesh: Mesh, label: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the plane that all three vertices of each face have, -1 where they differ, [F]."""
    own = label[mesh.faces]
    return np.where((own == own[:, :1]).all(1), own[:, 0], -1).astype(np.int32)


@dataclass(frozen=True)
class _Constraints:
    """Planes that vertices stay in: one, two that meet in a line, or three in a corner.

    Attributes:
        vertex: numbers, ascending, [K].
        normals, offsets: of up to three planes each, zeros for none, [K, 3, 3] and [K, 3].
        inverse: pseudo-inverses of ``normals``, [K, 3, 3].
    """

    vertex: NDArray[np.int64]
    normals: Array
    offsets: Array
    inverse: Array

    def single(self, count: int) -> NDArray[np.bool_]:
        """Tell which of ``count`` vertices have one plane, bool [count]."""
        result = np.zeros(count, bool)
        result[self.vertex[~self.normals[:, 1].any(1)]] = True
        return result

    def raise_planes(self, vertex: NDArray[np.int64], height: Array) -> None:
        """Move the planes of vertices [K] that have one each outwards by heights [K]."""
        self.offsets[np.searchsorted(self.vertex, vertex), 0] += height

    def moves(self, at: Array) -> Array:
        """Return the shortest way of the vertices at ``at`` [N, 3] into their planes, [K, 3]."""
        missing = self.offsets - np.einsum("nij,nj->ni", self.normals, at[self.vertex])
        return np.asarray(np.einsum("nij,nj->ni", self.inverse, missing))

    def project(self, at: Array) -> Array:
        """Return the vertices [N, 3] in their planes."""
        result = at.copy()
        result[self.vertex] += self.moves(at)
        return result


def _constraints(
    mesh: Mesh, pixel: Array, planes: Planes, label: NDArray[np.int32], o: PlaneExtensionOptions
) -> _Constraints:
    """Return the planes of each vertex that has one: its own, and those of neighbours that meet it at an angle."""
    count = len(planes.normals)
    a, b = directed_edges(mesh.faces)
    meet = planes.normals @ planes.normals.T < np.cos(np.radians(o.angle))
    both = (label[a] >= 0) & (label[b] >= 0)
    a, b = a[both], b[both]
    corner = meet[label[a], label[b]]
    own = np.flatnonzero(label >= 0)
    keys = np.unique(np.r_[own * count + label[own], a[corner] * count + label[b[corner]]])
    whole = _assembled(planes, *np.divmod(keys, count), label)
    way = np.linalg.norm(whole.moves(mesh.vertices), axis=1)
    off = np.abs(np.einsum("nij,nj->ni", whole.normals, mesh.vertices[whole.vertex]) - whole.offsets).max(1)
    far = way > o.reach * pixel[whole.vertex] + off
    alone = _assembled(planes, whole.vertex[far], label[whole.vertex[far]].astype(np.int64), label)
    near = ~far
    order = np.argsort(np.r_[whole.vertex[near], alone.vertex])
    return _Constraints(
        *(np.concatenate([getattr(whole, name)[near], getattr(alone, name)])[order]
          for name in ("vertex", "normals", "offsets", "inverse"))
    )  # fmt: skip


def _assembled(
    planes: Planes, vertex: NDArray[np.int64], plane: NDArray[np.int64], label: NDArray[np.int32]
) -> _Constraints:
    """Return the constraints of pairs of a vertex and a plane, ordered by vertex: its own plane, and two at most."""
    order = np.lexsort((plane != label[vertex], vertex))
    vertex, plane = vertex[order], plane[order]
    rows, first, at, times = np.unique(vertex, return_index=True, return_inverse=True, return_counts=True)
    place = np.arange(len(vertex)) - np.repeat(first, times)
    kept = place < 3
    normals, offsets = np.zeros((len(rows), 3, 3)), np.zeros((len(rows), 3))
    normals[at[kept], place[kept]], offsets[at[kept], place[kept]] = (
        planes.normals[plane[kept]], planes.offsets[plane[kept]],
    )  # fmt: skip
    return _Constraints(rows, normals, offsets, np.asarray(np.linalg.pinv(normals, rcond=PARALLEL), np.float64))
