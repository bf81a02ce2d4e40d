# SPDX-License-Identifier: GPL-3.0-or-later
"""Sample points with normals on the starting surface by Poisson disks, at a given spacing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.clean import face_areas
from mgf_engine.geometry.rasterize import face_normals, render_mesh
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import Scene, most_pixels
from mgf_engine.native.library import call
from mgf_engine.native.parallel import parallel_map
from mgf_engine.options.algorithms import parameter

_CHUNK = 1 << 16  # samples that are computed at a time, which bounds the memory
_BYTES_PER_PIXEL, _BYTES_PER_POINT = 30, 150  # while a view is drawn


@dataclass(frozen=True)
class SampleOptions:
    """Options of samples on the starting surface."""

    candidates: float = parameter(4.0, "Number of random points for each point that stays", low=1)
    disk: float = parameter(
        0.8, "Minimum distance of two points as a share of the spacing; 0.8 gives as many points as a grid"
    )
    least_views: int = parameter(2, "Minimum number of photos that show a point", low=1)
    depth_tolerance: float = parameter(
        0.01, "Difference of depth up to which a photo shows a point, as a share of the depth", low=1e-6
    )
    least_facing: float = parameter(0.05, "Minimum cosine between a face's normal and the viewing direction", high=1)


@dataclass(frozen=True)
class Samples:
    """Samples of a surface.

    Attributes:
        points: [N, 3], normalised frame.
        faces: the face that each lies on, [N].
        normals: outward unit normals, [N, 3].
        colors: uint8 [N, 3].
        spacing: their distance from each other.
    """

    points: NDArray[np.float64]
    faces: NDArray[np.int64]
    normals: NDArray[np.float64]
    colors: NDArray[np.uint8]
    spacing: float


def sample_surface(
    mesh: Mesh,
    scene: Scene,
    indices: Sequence[int],
    most: int,
    spacing: float,
    seed: int = 0,
    options: SampleOptions = SampleOptions(),
) -> Samples:
    """Sample the faces of a surface that photos show.

    Args:
        mesh: normalised frame.
        scene: photos and cameras.
        indices: the photos.
        most: approximate maximum number of samples; ``spacing`` grows for that.
        spacing: distance between samples.
        seed: of the random points.
        options: of the sampling.
    """
    shown = _shown(mesh, scene, indices)
    mesh = Mesh(mesh.vertices, mesh.faces[shown], mesh.colors)
    area = face_areas(mesh)
    if not len(area):
        return Samples(np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3), np.uint8), spacing)
    spacing = max(spacing, float(np.sqrt(area.sum() / max(most, 1))))
    face, points = sample_poisson_disk(mesh, spacing, np.random.default_rng(seed), options)
    normals = face_normals(mesh)[face]
    colors, seen = _colors(mesh, scene, indices, points, normals, spacing, options)
    return Samples(points[seen], np.flatnonzero(shown)[face[seen]], normals[seen], colors[seen], spacing)


def sample_poisson_disk(
    mesh: Mesh, spacing: float, generator: np.random.Generator, options: SampleOptions = SampleOptions()
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Sample a mesh by Poisson disks.

    Args:
        mesh: any.
        spacing: approximate distance between samples.
        generator: of the random points.
        options: of the sampling.

    Returns:
        faces [N] and points on them [N, 3].
    """
    area = face_areas(mesh)
    total = np.cumsum(area)
    count = int(np.ceil(options.candidates * total[-1] / spacing**2))
    face = np.searchsorted(total, (np.arange(count) + generator.random(count)) / count * total[-1])
    face = np.minimum(face, len(area) - 1)
    root, v = generator.random((2, count))
    np.sqrt(root, out=root)
    points = np.empty((count, 3))
    for begin in range(0, count, _CHUNK):
        part = slice(begin, begin + _CHUNK)
        weights = np.stack([1 - root[part], root[part] * (1 - v[part]), root[part] * v[part]], 1)
        points[part] = np.einsum("nk,nkj->nj", weights, mesh.vertices[mesh.faces[face[part]]])
    kept = poisson_disk_subset(points, options.disk * spacing)
    return face[kept], points[kept]


def poisson_disk_subset(points: NDArray[np.float64], radius: float) -> NDArray[np.int64]:
    """Choose a maximal subset of points [N, 3] of which no two are nearer than ``radius``.

    Of points that exclude each other the first one is kept (kernel ``mgf_poisson_disk``).

    Returns:
        Their numbers, ascending.
    """
    if not len(points):
        return np.zeros(0, np.int64)
    slots = 1 << len(points).bit_length()
    kept, work = np.zeros(len(points), np.uint8), (np.empty(slots, np.int32), np.empty(len(points), np.int32))
    call("mgf_poisson_disk", len(points), np.ascontiguousarray((points - points.min(0)) / radius), slots, *work, kept)
    return np.flatnonzero(kept)


def _shown(mesh: Mesh, scene: Scene, indices: Sequence[int]) -> NDArray[np.bool_]:
    """Tell which faces at least one photo shows from the front, bool [F]."""
    result, normals = np.zeros(len(mesh.faces), bool), face_normals(mesh)
    middle = mesh.vertices[mesh.faces].mean(1)

    def shown(index: int) -> NDArray[np.int32]:
        face = render_mesh(mesh, scene.views[index]).face
        seen = np.unique(face[face >= 0])
        return seen[((scene.views[index].centre - middle[seen]) * normals[seen]).sum(1) > 0]

    for faces in parallel_map(shown, indices, bytes_each=_BYTES_PER_PIXEL * most_pixels(scene.views)):
        result[faces] = True
    return result


def _colors(
    mesh: Mesh,
    scene: Scene,
    indices: Sequence[int],
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    spacing: float,
    options: SampleOptions,
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Average the colours around points in the photos that show them.

    Args:
        mesh: what hides points from photos.
        scene: photos and cameras.
        indices: the photos.
        points: on the mesh, [N, 3].
        normals: outward, [N, 3].
        spacing: side of the square that each point stands for.
        options: which photos show a point.

    Returns:
        colours uint8 [N, 3], and whether enough photos show each point, bool [N].
    """
    total, weight, views = np.zeros((len(points), 3)), np.zeros(len(points)), np.zeros(len(points), int)

    def seen(index: int) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.uint8]]:
        """Return the points that a view shows, how frontally, and the colours around them."""
        view = scene.views[index]
        away = view.centre - points
        facing = (away * normals).sum(1) / np.maximum(np.linalg.norm(away, axis=1), 1e-12)
        rows = np.flatnonzero(facing > options.least_facing)
        uv, depth, framed = view.project_into_frame(points[rows])
        column, row = uv[framed].astype(int).T
        rows, at, depth = rows[framed], (row, column), depth[framed]
        surface = render_mesh(mesh, view).depth[at]
        shown = (surface > 0) & (np.abs(surface - depth) < options.depth_tolerance * depth)
        rows = rows[shown]
        if not len(rows):
            return rows, facing[rows], np.zeros((0, 3), np.uint8)
        size = max(1, round(spacing * view.fx / float(np.median(depth[shown]))))  # px that a sample stands for
        return rows, facing[rows], cv2.blur(scene.photo(index), (size, size))[at][shown]  # type: ignore[return-value]

    each = _BYTES_PER_PIXEL * most_pixels(scene.views) + _BYTES_PER_POINT * len(points)
    for rows, facing, color in parallel_map(seen, indices, bytes_each=each):
        total[rows] += facing[:, None] * color
        weight[rows] += facing
        views[rows] += 1
    colors = total / np.maximum(weight, 1e-12)[:, None]
    return np.clip(colors.round(), 0, 255).astype(np.uint8), views >= options.least_views
