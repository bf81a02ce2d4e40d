# SPDX-License-Identifier: GPL-3.0-or-later
"""Blend the borders of flattened planes: no step where a plane ends or a bowed wall is two planes, and no fold.

Vertices that go into a plane leave their neighbours behind. So moves fade out over these, small steps between nearly
parallel planes become slopes, ragged borders are smoothed, and vertices whose faces turned over go back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from mgf_engine.geometry.clean import open_edges
from mgf_engine.geometry.components import label_components
from mgf_engine.geometry.normals import face_cross_products, unit_vectors, vertex_normals
from mgf_engine.mesh.plane_detection import Planes
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.topology import directed_edges
from mgf_engine.options.algorithms import parameter

Array = NDArray[np.float64]
# Minimum share of a face's area before that makes it turned: one whose corners all lie on a crease has none, and so no
# direction.
_TURNED_AREA = 1e-6
_TAUBIN = (0.5, -0.53)  # shares of the way to the mean of the neighbours: towards it, and farther back
_STEPS_BACK = 4  # that a vertex goes back at most: by half its way each, the last one altogether


@dataclass(frozen=True)
class PlaneBorderOptions:
    """Options of blending the borders of planes."""

    angle: float = parameter(20.0, "Maximum angle between two planes that are nearly parallel", "degrees")
    steps: tuple[float, float] = parameter(
        (0.8, 1.6), "Height of a step between such planes up to which it becomes a slope, and from which it stays",
        "ground px",
    )  # fmt: skip
    slope_rounds: int = parameter(20, "Number of rounds of smoothing that spread a slope, one edge each")
    slope_share: float = parameter(0.9, "Factor on the height of a slope after each round of smoothing", high=1)
    fade_rounds: int = parameter(10, "Number of rounds of smoothing that spread the moves of planes, one edge each")
    fade_share: float = parameter(0.9, "Factor on spread moves after each round of smoothing", high=1)
    fade_outward: float = parameter(
        0.3, "Further factor on spread moves out of the building: walls sink at windows, whose reveals stay", high=1
    )
    smooth_rounds: int = parameter(
        10,
        "Number of rounds of smoothing along the borders of planes, then of sliding beside them; 0 leaves them",
        low=0,
    )
    shortest: int = parameter(20, "Minimum number of vertices of such a border; shorter ones, around islands, stay")


def smooth_borders(
    mesh: Mesh,
    at: Array,
    label: NDArray[np.int32],
    free: NDArray[np.bool_],
    project: Callable[[Array], Array],
    options: PlaneBorderOptions = PlaneBorderOptions(),
) -> tuple[Array, NDArray[np.bool_]]:
    """Smooth the curves where planes end, each within its plane, without shrinking them (Taubin 1995).

    Args:
        mesh: its faces.
        at: vertices in their planes, [N, 3].
        label: the plane that each face lies in, -1 for none, [F].
        free: which vertices may move, bool [N].
        project: puts vertices [N, 3] back into their planes.
        options: number of rounds.

    Returns:
        The vertices [N, 3], and which of the free ones lie on such a curve, bool [N].
    """
    edges = np.stack(open_edges(replace(mesh, faces=mesh.faces[label >= 0])))
    edges = edges[:, free[edges].all(0)]
    curve = label_components(len(at), *edges)
    a, b = edges[:, np.bincount(curve)[curve[edges[0]]] >= options.shortest]
    ends = np.bincount(np.r_[a, b], minlength=len(at))
    moved = np.flatnonzero(ends == 2)  # where curves end or meet, they stay
    mean = sparse.csr_matrix((np.full(2 * len(a), 0.5), (np.r_[a, b], np.r_[b, a])), (len(at), len(at)))[moved]
    at = at.copy()
    for share in _TAUBIN * options.smooth_rounds:
        at[moved] += share * (mean @ at - at[moved])
        at = project(at)
    return at, ends > 0


def slope_steps(
    mesh: Mesh,
    pixel: Array,
    planes: Planes,
    label: NDArray[np.int32],
    single: NDArray[np.bool_],
    options: PlaneBorderOptions = PlaneBorderOptions(),
) -> Array:
    """Return the moves [N, 3] that turn small steps between nearly parallel planes into slopes.

    Args:
        mesh: whose vertices get labels.
        pixel: size of a ground pixel at each vertex, [N].
        planes: found on this mesh.
        label: the plane of each vertex, -1 for none, [N].
        single: which vertices lie in one plane only, bool [N]; the others stay.
        options: angle, heights and widths.
    """
    a, b = directed_edges(mesh.faces)
    parallel = planes.normals @ planes.normals.T > np.cos(np.radians(options.angle))
    meet = (label[a] >= 0) & (label[b] >= 0) & (label[a] != label[b]) & parallel[label[a], label[b]] & single[a]
    a, own, other = a[meet], label[a[meet]], label[b[meet]]
    step = planes.distances(mesh.vertices[a], own) - planes.distances(mesh.vertices[a], other)
    low, high = options.steps
    step *= np.clip((high - np.abs(step) / pixel[a]) / max(high - low, 1e-12), 0, 1)
    times = np.bincount(a, minlength=len(label))
    half = np.bincount(a, step / 2, len(label)) / np.maximum(times, 1)
    moves, fixed = np.zeros((len(label), 3)), ~single | (times > 0)
    moves[times > 0] = half[times > 0, None] * planes.normals[label[times > 0]]
    for _ in range(options.slope_rounds):
        moves = mesh.adjacency.smooth(moves, fixed)
        moves[~fixed] *= options.slope_share
    return moves


def fade_moves(
    mesh: Mesh, moves: Array, fixed: NDArray[np.bool_], options: PlaneBorderOptions = PlaneBorderOptions()
) -> Array:
    """Return moves [N, 3] that fade out over the neighbours of vertices in planes.

    Args:
        mesh: before the moves.
        moves: of its vertices, [N, 3].
        fixed: which vertices are in planes and keep their moves, bool [N].
        options: over how many edges.
    """
    free = np.flatnonzero(~fixed)
    normals = vertex_normals(mesh)[free]
    moves = np.ascontiguousarray(moves)
    for _ in range(options.fade_rounds):
        moves = mesh.adjacency.smooth(moves, fixed)
        outward = np.einsum("ij,ij->i", moves[free], normals) > 0
        moves[free] *= np.where(outward, options.fade_outward, 1.0)[:, None] * options.fade_share
    return moves


def undo_folds(
    mesh: Mesh, before: Array, at: Array, planes: Planes | None = None, label: NDArray[np.int32] | None = None
) -> tuple[Array, NDArray[np.bool_]]:
    """Move vertices back until no face is turned over: of each such face the one that went furthest, by half its way.

    A face that lies in a plane must not face away from it; faces of an overhanging dent did before. Any other must not
    face away from its own direction before.

    Args:
        mesh: its faces.
        before: vertices before they were moved, [N, 3].
        at: vertices, [N, 3].
        planes: with normals out of the building; None for none.
        label: the plane that each face lies in, -1 for none, [F]; given with the planes.

    Returns:
        The vertices [N, 3], and which of them were not moved back, bool [N].
    """
    at, times = at.copy(), np.zeros(len(at), np.int64)
    own, way = face_cross_products(before, mesh.faces), np.linalg.norm(at - before, axis=1)
    size = np.linalg.norm(own, axis=1)
    normals = unit_vectors(own)
    if planes is not None and label is not None:
        normals = np.where(label[:, None] >= 0, planes.normals[label], normals)
    check = np.flatnonzero((way > 0)[mesh.faces].any(1))
    while len(check):
        facing = np.einsum("ij,ij->i", face_cross_products(at, mesh.faces[check]), normals[check])
        turned = check[facing < -_TURNED_AREA * size[check]]
        corner = way[mesh.faces[turned]].argmax(1)
        back = np.unique(mesh.faces[turned, corner])
        back = back[way[back] > 0]
        times[back] += 1
        share = np.where(times[back] < _STEPS_BACK, 0.5, 0.0)
        at[back] = before[back] + share[:, None] * (at[back] - before[back])
        way[back] *= share
        touched = np.zeros(len(at), bool)
        touched[back] = True
        check = np.flatnonzero(touched[mesh.faces].any(1))
    return at, times == 0
