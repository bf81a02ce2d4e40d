# SPDX-License-Identifier: GPL-3.0-or-later
"""Trim the border of a mesh: remove unconfirmed faces along it, and make the border smooth.

Removing whole faces would leave a border as ragged as the faces are large. Instead, the indicator function of the kept
faces is diffused over the mesh for a short time, and the mesh is cut at its level 0.5. Repeated, this moves borders by
mean curvature (threshold dynamics of Merriman, Bence and Osher 1992): straight lines stay, while teeth, thin strips and
narrow bays vanish. A border that stays, such as the foot of a building, is smoothed along itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from mgf_engine.geometry.clean import border_vertices, face_areas, parts, split_nonmanifold, weld, with_faces
from mgf_engine.geometry.clip import clip_level
from mgf_engine.geometry.normals import vertex_normals
from mgf_engine.geometry.rasterize import face_normals
from mgf_engine.mesh.holes import boundary_loops, rim_length
from mgf_engine.mesh.plane_borders import PlaneBorderOptions, smooth_borders, undo_folds
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.topology import directed_edges
from mgf_engine.options.algorithms import parameter

_REACH = 4.0  # standard deviations of the heat kernel beyond which values stay as they are
_STEPS = 3  # of implicit Euler
#: Vertex attribute, int32 [N]: the connected component before the cut.
_PART = "part"


@dataclass(frozen=True)
class MeshBorderOptions:
    """Options of trimming the border of a mesh."""

    spread: float = parameter(
        3.0,
        "Spread of the heat that straightens a border; teeth and strips up to 1.3 of it wide go, 0 cuts whole faces",
        "ground px",
    )
    snap: float = parameter(0.25, "Share of an edge below which its end moves onto the cut", high=0.5)
    photos: int = parameter(
        1, "Number of photos that must show a face connected to the border; 0 keeps all faces", low=0
    )
    fallen: float = parameter(
        0.01,
        "Minimum area of a piece disconnected by trimming, as a share of the largest part; smaller ones are removed",
        high=1,
    )
    weights: tuple[float, float] = parameter((0.05, 3.0), "Bounds of the cotangent weights of edges", low=1e-3)
    smooth_rounds: int = parameter(60, "Number of rounds of smoothing along the border; 0 leaves it", low=0)
    crease: float = parameter(
        45.0, "Angle between a vertex's normal and those of its faces from which it is at an edge and stays", "degrees"
    )
    shortest: int = parameter(6, "Minimum number of vertices of a piece of border between edges that is smoothed")
    slide_rings: int = parameter(3, "Number of edges from the border up to which vertices make room for it", low=0)
    slide_rounds: int = parameter(10, "Number of rounds in which they do", low=0)


def trim_border(
    mesh: Mesh,
    views: NDArray[np.integer],
    pixel: NDArray[np.floating],
    hole: NDArray[np.floating],
    options: MeshBorderOptions = MeshBorderOptions(),
) -> Mesh:
    """Remove unconfirmed faces along the border of a mesh, and small pieces that this disconnects.

    Args:
        mesh: a manifold, in any frame.
        views: number of photos that show each vertex, [N].
        pixel: size of a ground pixel at each vertex, in the mesh's units, [N].
        hole: loops of open edges shorter than this are holes that will be closed, and no border, [N].
        options: how many photos must show a face, how smooth the border is, and which pieces are small.
    """
    kept = find_supported_faces(mesh, views, hole, options)
    if kept.all() or not kept.any():
        return mesh
    before = parts(mesh)
    cut = remove_faces(
        replace(mesh, values={**mesh.values, _PART: _part_of_vertices(mesh, before)}), kept, pixel, options
    )
    areas = face_areas(cut)
    label = parts(cut)
    area = np.bincount(label, areas)
    # Parts that were separate before, such as chimneys, have passed the component filter: keep them, however small.
    whole = np.bincount(before, face_areas(mesh))[cut.values[_PART][cut.faces[:, 0]]]
    stays = (area[label] >= options.fallen * area.max(initial=0.0)) | (area[label] > 0.5 * whole)
    values = {name: value for name, value in cut.values.items() if name != _PART}
    return split_nonmanifold(with_faces(replace(cut, values=values), cut.faces[stays]))


def smooth_border(mesh: Mesh, hole: NDArray[np.floating], options: MeshBorderOptions = MeshBorderOptions()) -> Mesh:
    """Smooth the border of a mesh along itself and within the surface, without shrinking it (Taubin 1995).

    Where two walls meet it stays; no face turns over.

    Args:
        mesh: in any frame.
        hole: loops of open edges shorter than this are holes, and no border, [N].
        options: number of rounds, and what an edge is.
    """
    border = _border_but_holes(mesh, hole)
    if not options.smooth_rounds or not border.any():
        return mesh
    rim, normals = border_vertices(mesh), vertex_normals(mesh)
    cosine = np.einsum("fj,fkj->fk", face_normals(mesh), normals[mesh.faces])
    edge = np.zeros(len(border), bool)
    edge[mesh.faces[cosine < np.cos(np.radians(options.crease))]] = True

    def into_surface(at: NDArray[np.float64], rows: NDArray[np.bool_] = border) -> NDArray[np.float64]:
        """Put vertices back into the tangent planes that they were moved from, in place."""
        out = np.einsum("ij,ij->i", at[rows] - mesh.vertices[rows], normals[rows])
        at[rows] -= out[:, None] * normals[rows]
        return at

    whole = np.zeros(len(mesh.faces), np.int32)
    curves = PlaneBorderOptions(smooth_rounds=options.smooth_rounds, shortest=options.shortest)
    at, near = smooth_borders(mesh, mesh.vertices, whole, border & ~edge, into_surface, curves)
    a, b = directed_edges(mesh.faces)
    for _ in range(options.slide_rings):
        near[a[near[b]]] = True
    near &= ~rim & ~edge
    for _ in range(options.slide_rounds):
        at = into_surface(mesh.adjacency.smooth(np.ascontiguousarray(at), ~near), near)
    return replace(mesh, vertices=undo_folds(mesh, mesh.vertices, at)[0])


def _part_of_vertices(mesh: Mesh, part: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the connected component of each vertex, int32 [N], from that of each face [F]."""
    result = np.zeros(len(mesh.vertices), np.int32)
    result[mesh.faces] = part[:, None]
    return result


def find_supported_faces(
    mesh: Mesh,
    views: NDArray[np.integer],
    hole: NDArray[np.floating],
    options: MeshBorderOptions = MeshBorderOptions(),
) -> NDArray[np.bool_]:
    """Find the faces that are confirmed or enclosed by confirmed ones, bool [F].

    A face is confirmed if photos show at least two of its corners. Unconfirmed faces that do not reach the border
    close a hole, and are kept.

    Args:
        mesh: in any frame.
        views: number of photos that show each vertex, [N].
        hole: loops of open edges shorter than this are holes that will be closed, and no border, [N].
        options: how many photos must show a vertex.
    """
    kept = np.ones(len(mesh.faces), bool)
    rows = np.flatnonzero((views[mesh.faces] >= options.photos).sum(1) < 2)
    if not len(rows):
        return kept
    border = _border_but_holes(mesh, hole)
    label = parts(replace(mesh, faces=mesh.faces[rows]))
    at_border = np.zeros(label.max() + 1, bool)
    at_border[label[border[mesh.faces[rows]].any(1)]] = True
    kept[rows[at_border[label]]] = False
    return kept


def _border_but_holes(mesh: Mesh, hole: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Find the vertices on open edges, bool [N], but for those around holes: loops shorter than ``hole`` [N]."""
    border = border_vertices(mesh)
    for loop in boundary_loops(mesh):
        if rim_length(mesh, loop) <= np.median(hole[loop]):
            border[loop] = False
    return border


def remove_faces(
    mesh: Mesh, kept: NDArray[np.bool_], pixel: NDArray[np.floating], options: MeshBorderOptions = MeshBorderOptions()
) -> Mesh:
    """Remove faces; the border towards those that are kept is smooth.

    Args:
        mesh: a manifold, in any frame.
        kept: faces that are kept, bool [F].
        pixel: size of a ground pixel at each vertex, in the mesh's units, [N].
        options: smoothness of the border.
    """
    if options.spread <= 0 or kept.all() or not kept.any():
        return with_faces(mesh, mesh.faces[kept])
    areas = face_areas(mesh)
    whole = np.maximum(np.bincount(mesh.faces.ravel(), np.repeat(areas, 3), len(mesh.vertices)), 1e-300)
    stays = np.bincount(mesh.faces.ravel(), np.repeat(areas * kept, 3), len(mesh.vertices)) / whole
    level = _diffuse(mesh, stays, np.asarray(pixel, np.float64), options) - 0.5
    return weld(clip_level(*_snap_to_cut(mesh, level, options.snap)))


def _diffuse(mesh: Mesh, value: NDArray[np.float64], pixel: NDArray[np.float64], options: MeshBorderOptions
              ) -> NDArray[np.float64]:  # fmt: skip
    """Diffuse values [N] on the mesh by ``options.spread`` (standard deviation); values far from any change stay."""
    mixed = (value > 0) & (value < 1)
    if not mixed.any():
        return value
    at = mesh.vertices
    reach = _REACH * options.spread * pixel
    away, _ = cKDTree(at[mixed]).query(at, distance_upper_bound=float(reach.max()))
    near = np.flatnonzero(away <= reach)
    place = np.full(len(at), -1)
    place[near] = np.arange(len(near))
    faces = place[mesh.faces[(place[mesh.faces] >= 0).all(1)]]
    flow, area = _laplacian(at[near], faces, options)
    time = 0.5 * (options.spread * pixel[near]) ** 2 / _STEPS
    solve = splu((sparse.diags(area) + sparse.diags(np.sqrt(time)) @ flow @ sparse.diags(np.sqrt(time))).tocsc())
    result = value.copy()
    for _ in range(_STEPS):
        result[near] = solve.solve(area * result[near])
    return result


def _laplacian(
    at: NDArray[np.float64], faces: NDArray[np.integer], options: MeshBorderOptions
) -> tuple[sparse.csr_matrix, NDArray[np.float64]]:
    """Return the positive Laplacian by bounded cotangents, [N, N], and a third of the area around each vertex, [N]."""
    a, b, c = (at[faces[:, k]] for k in range(3))
    doubled = np.maximum(np.linalg.norm(np.cross(b - a, c - a), axis=1), 1e-300)
    pairs, amounts = [], []
    for k in range(3):
        i, j, far = (faces[:, (k + s) % 3] for s in range(3))
        cotangent = np.einsum("ij,ij->i", at[i] - at[far], at[j] - at[far]) / doubled
        pairs.append(np.stack([i, j]))
        amounts.append(0.5 * np.clip(cotangent, *options.weights))
    (i, j), amount = np.concatenate(pairs, 1), np.concatenate(amounts)
    count = len(at)
    weight = sparse.coo_matrix((np.r_[amount, amount], (np.r_[i, j], np.r_[j, i])), (count, count)).tocsr()
    area = np.bincount(faces.ravel(), np.repeat(doubled / 6, 3), count)
    return sparse.diags(np.asarray(weight.sum(1)).ravel()) - weight, np.maximum(area, 1e-9 * doubled.max(initial=1.0))


def _snap_to_cut(mesh: Mesh, level: NDArray[np.float64], snap: float) -> tuple[Mesh, NDArray[np.float64]]:
    """Move vertices close to the cut onto it, along the edge that is shortest to go: this leaves no slivers.

    Returns:
        The mesh, and its level [N].
    """
    a, b = directed_edges(mesh.faces)
    crossed = level[a] * level[b] < 0
    a, b = a[crossed], b[crossed]
    share = level[a] / (level[a] - level[b])
    few = share < snap
    a, b, share = a[few], b[few], share[few]
    order = np.argsort(share, kind="stable")
    vertex, first = np.unique(a[order], return_index=True)
    rows = order[first]
    vertices, level = mesh.vertices.copy(), level.copy()
    vertices[vertex] += share[rows, None] * (mesh.vertices[b[rows]] - mesh.vertices[vertex])
    level[vertex] = 0
    return replace(mesh, vertices=vertices), level
