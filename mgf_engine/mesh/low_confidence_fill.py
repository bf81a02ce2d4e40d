# SPDX-License-Identifier: GPL-3.0-or-later
"""Fill dents that no two photos confirm, such as rooms behind mirroring panes, by a membrane spanned over their rim."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from mgf_engine.geometry.clean import border_vertices, edge_keys, with_faces
from mgf_engine.model.mesh import Mesh
from mgf_engine.options.algorithms import parameter

MERGE_DISTANCE = 1e-5  # of the mesh's size


@dataclass(frozen=True)
class LowConfidenceFillOptions:
    """Options of the membrane over unconfirmed dents."""

    unconfirmed: float = parameter(
        0.2, "Confidence below which a vertex is unconfirmed; one photo alone gives more", high=1
    )
    largest: float = parameter(0.2, "Maximum size of a patch, as a share of the mesh's size", high=1)
    least_rim: int = parameter(3, "Minimum number of vertices on the rim of a patch", low=3)
    bag: float = parameter(
        2.5, "Ratio of a patch's area to that of its membrane from which it is a bag; a cube's corner has 1.7"
    )


def fill_low_confidence(
    mesh: Mesh, confidence: NDArray[np.floating], options: LowConfidenceFillOptions = LowConfidenceFillOptions()
) -> Mesh:
    """Move the vertices of unconfirmed patches onto the membrane over their rim: each to the mean of its neighbours.

    Only dents, and bags behind a narrow opening, are moved: a protrusion may be a corner that few photos see. A bag
    shrinks to a point, and its faces are removed. Vertices on open edges are fixed, and so are patches with hardly any
    rim (separate components) and patches that would become non-manifold.

    Args:
        confidence: [N], 0..1.
    """
    loose = (confidence < options.unconfirmed) & ~border_vertices(mesh)
    if not loose.any():
        return mesh
    neighbours = _adjacency_matrix(mesh)
    moved, label = _find_patches(mesh, neighbours, np.flatnonzero(loose), options)
    membrane = _span_membrane(mesh, neighbours, moved)
    wrong = _find_dents_and_bags(mesh, membrane, moved, label, options)
    moved, label = moved[wrong], label[wrong]
    while len(moved):
        vertices = mesh.vertices.astype(np.float64)
        vertices[moved] = membrane[moved]
        first = _representatives(vertices, moved)
        faces, nonmanifold = _merge_vertices(mesh.faces, first)
        if not nonmanifold.any():
            return with_faces(replace(mesh, vertices=vertices.astype(mesh.vertices.dtype)), faces)
        bad = np.isin(first[moved], np.unique(first[nonmanifold]))
        bad = np.isin(label, label[bad]) if bad.any() else np.ones(len(moved), bool)
        moved, label = moved[~bad], label[~bad]
    return mesh


def _span_membrane(mesh: Mesh, neighbours: sparse.csr_matrix, moved: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return all vertices with the moved ones where each is the mean of its neighbours, [N, 3]."""
    vertices = mesh.vertices.astype(np.float64)
    if len(moved):
        rest = np.setdiff1d(np.arange(len(vertices)), moved)
        laplacian = (sparse.diags(np.asarray(neighbours.sum(1)).ravel()) - neighbours).tocsr()[moved]
        vertices[moved] = splu(laplacian[:, moved].tocsc()).solve(-(laplacian[:, rest] @ vertices[rest]))
    return vertices


def _find_dents_and_bags(
    mesh: Mesh,
    membrane: NDArray[np.float64],
    moved: NDArray[np.int64],
    label: NDArray[np.int32],
    options: LowConfidenceFillOptions,
) -> NDArray[np.bool_]:
    """Return which of the moved vertices, [M], are of patches that gain volume when spanned or shrink to a fraction."""
    patch = np.full(len(membrane), -1)
    patch[moved] = label
    of_face = patch[mesh.faces].max(1)  # the vertices of a face are of one patch or of none
    faces, of_face = mesh.faces[of_face >= 0], of_face[of_face >= 0]
    count = int(label.max(initial=-1)) + 1

    def area_and_volume(vertices: NDArray[np.floating]) -> tuple[NDArray[np.float64], ...]:
        a, b, c = (vertices[faces[:, k]].astype(np.float64) for k in range(3))
        doubled = np.cross(b - a, c - a)
        area, volume = np.linalg.norm(doubled, axis=1) / 2, (doubled * a).sum(1) / 6
        return tuple(np.bincount(of_face, amount, count).astype(np.float64) for amount in (area, volume))

    (area, volume), (membrane_area, membrane_volume) = area_and_volume(mesh.vertices), area_and_volume(membrane)
    wrong: NDArray[np.bool_] = (membrane_volume > volume) | (area > options.bag * membrane_area)
    return wrong[label]


def _representatives(vertices: NDArray[np.float64], moved: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the vertex that stands for each, [N]: for moved ones the first at the same place, for others they
    themselves."""
    size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    place = np.round(vertices / (MERGE_DISTANCE * size)).astype(np.int64)
    _, index, where = np.unique(place, axis=0, return_index=True, return_inverse=True)
    result = np.arange(len(vertices))
    result[moved] = index[where.ravel()][moved]
    return result


def _merge_vertices(faces: NDArray[np.int32], first: NDArray[np.int64]) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Return faces between the vertices that stand for theirs, once each; which vertices [N] are at an edge of three
    faces."""
    merged = first[faces]
    proper = (merged[:, 0] != merged[:, 1]) & (merged[:, 1] != merged[:, 2]) & (merged[:, 2] != merged[:, 0])
    merged = merged[proper]
    _, once = np.unique(np.sort(merged, 1), axis=0, return_index=True)
    merged = merged[np.sort(once)].astype(np.int32)
    nonmanifold = np.zeros(len(first), bool)
    key, count = np.unique(edge_keys(merged)[0], return_counts=True)
    nonmanifold[key[count > 2] >> 32] = nonmanifold[key[count > 2] & 0xFFFFFFFF] = True
    return merged, nonmanifold


def _adjacency_matrix(mesh: Mesh) -> sparse.csr_matrix:
    """Return which vertices an edge joins: 1 or 0, [N, N]."""
    start, neighbour = mesh.adjacency.neighbours()
    return sparse.csr_matrix((np.ones(len(neighbour)), neighbour, start), (len(mesh.vertices),) * 2)


def _find_patches(
    mesh: Mesh, neighbours: sparse.csr_matrix, loose: NDArray[np.int64], options: LowConfidenceFillOptions
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Return those of these vertices whose patch is small and held by a rim, [M], and which patch that is, [M]."""
    count, label = connected_components(neighbours[loose][:, loose], directed=False)
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, label, mesh.vertices[loose])
    np.maximum.at(high, label, mesh.vertices[loose])
    small = np.linalg.norm(high - low, axis=1) <= options.largest * np.linalg.norm(np.ptp(mesh.vertices, axis=0))
    belongs = sparse.coo_matrix((np.ones(len(loose)), (label, loose)), (count, len(mesh.vertices))).tocsr()
    touched = (belongs @ neighbours).tocoo()
    on_rim = ~np.isin(touched.col, loose)
    held = np.bincount(touched.row[on_rim], minlength=count) >= options.least_rim
    good = (small & held)[label]
    return loose[good], label[good]
