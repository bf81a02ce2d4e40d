# SPDX-License-Identifier: GPL-3.0-or-later
"""Points with normals on the starting surface, as dense as the field needs them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.mesh.model import Mesh
from mgf_engine.mesh.view import face_normals, look
from mgf_engine.scene.model import Scene

_FACING = 0.05  # least cosine between a face's normal and the direction to a view that shows it


@dataclass(frozen=True)
class Samples:
    """Points [N, 3] with outward unit normals [N, 3] and colours uint8 [N, 3]."""

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    colors: NDArray[np.uint8]


def sample_surface(mesh: Mesh, scene: Scene, indices: Sequence[int], count: int, seed: int = 0) -> Samples:
    """About ``count`` points on what the photos ``indices`` show of a surface, evenly by area."""
    normals = face_normals(mesh)
    corners = mesh.vertices[mesh.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    generator = np.random.default_rng(seed)
    face, points = _spread(corners, area, count, generator)
    normal = normals[face]
    colors, seen = _colors(mesh, scene, indices, points, normal)
    return Samples(points[seen], normal[seen], colors[seen])


def _spread(
    corners: NDArray[np.float64], area: NDArray[np.float64], count: int, generator: np.random.Generator
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Faces [N] and points [N, 3]; along the cumulated area in equal steps, so that they are even."""
    total = np.cumsum(area)
    face = np.searchsorted(total, (np.arange(count) + generator.random(count)) / count * total[-1])
    face = np.minimum(face, len(area) - 1)
    u, v = generator.random((2, count))
    root = np.sqrt(u)
    weights = np.stack([1 - root, root * (1 - v), root * v], 1)
    return face, np.einsum("nk,nkj->nj", weights, corners[face])


def _colors(
    mesh: Mesh, scene: Scene, indices: Sequence[int], points: NDArray[np.float64], normals: NDArray[np.float64]
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Mean colours by the photos that show the points [N, 3], and whether any does, bool [N]."""
    total, weight = np.zeros((len(points), 3)), np.zeros(len(points))
    for i in indices:
        view = scene.views[i]
        away = view.centre - points
        facing = (away * normals).sum(1) / np.maximum(np.linalg.norm(away, axis=1), 1e-12)
        rows = np.flatnonzero(facing > _FACING)
        uv, depth = view.project(points[rows])
        column, row = np.floor(uv[:, 0]), np.floor(uv[:, 1])
        framed = (depth > 0) & (column >= 0) & (row >= 0) & (column < view.width) & (row < view.height)
        rows, at, depth = rows[framed], (row[framed].astype(int), column[framed].astype(int)), depth[framed]
        surface = look(mesh, view).depth[at]
        shown = (surface > 0) & (np.abs(surface - depth) < 0.01 * depth)
        total[rows[shown]] += facing[rows[shown], None] * scene.photo(i)[at][shown]
        weight[rows[shown]] += facing[rows[shown]]
    colors = total / np.maximum(weight, 1e-12)[:, None]
    return np.clip(colors.round(), 0, 255).astype(np.uint8), weight > 0
