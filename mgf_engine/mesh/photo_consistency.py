# SPDX-License-Identifier: GPL-3.0-or-later
"""Photo-consistency of points on a surface: normalised cross-correlation of patches in the tangent plane.

A patch is a grid of points in the tangent plane, one ground pixel apart, sampled in the photos that see the vertex
best. Unlike depth maps, this rates any point, for example a vertex and its projection onto a plane.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.normals import unit_vectors, vertex_normals
from mgf_engine.geometry.rasterize import render_mesh
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import View, most_pixels
from mgf_engine.native.parallel import parallel_map
from mgf_engine.options.algorithms import parameter

Array = NDArray[np.float64]
_PIECE = 20_000  # places compared at a time: some 20 MB
_BYTES_PER_PIXEL, _BYTES_PER_VERTEX = 30, 150  # while a view is drawn


@dataclass(frozen=True)
class PatchOptions:
    """Options of comparing patches between photos."""

    views: int = parameter(4, "Number of photos, those that see a vertex best, in which its patch is compared", low=2)
    radius: int = parameter(2, "Half the side of a patch", "ground px", low=1)
    behind: float = parameter(4.0, "Distance behind the nearest surface up to which a vertex is seen", "ground px")
    facing: float = parameter(0.17, "Minimum cosine between a vertex's normal and the ray to the camera", high=1)
    noise: float = parameter(4.0, "Standard deviation of a photo's noise", "grey levels", low=0.1)
    partners: int = parameter(3, "Number of photos whose mean correlation with one counts, the most alike", low=1)


@dataclass(frozen=True)
class PatchPhotos:
    """Photos and which of them see each vertex best.

    Attributes:
        views: normalised frame.
        grey: number of a view -> uint8 [H, W], brightness.
        best: numbers of the views that see each vertex best, -1 for none, int32 [N, K].
        options: of the comparison.
    """

    views: Sequence[View]
    grey: Callable[[int], NDArray[np.uint8]]
    best: NDArray[np.int32]
    options: PatchOptions


def see_vertices(
    mesh: Mesh,
    pixel: Array,
    views: Sequence[View],
    grey: Callable[[int], NDArray[np.uint8]],
    options: PatchOptions = PatchOptions(),
) -> PatchPhotos:
    """Find the photos that see each vertex best: before anything else, largest and least slanted.

    Args:
        mesh: normalised frame.
        pixel: size of a ground pixel at each vertex, [N].
        views: normalised frame.
        grey: number of a view -> uint8 [H, W], brightness.
        options: how many, and what hides a vertex.
    """
    at, rows = mesh.vertices, np.arange(len(mesh.vertices))
    normals = vertex_normals(mesh)

    def sizes(view: View) -> Array:
        """Return how large and how frontally a view shows each vertex, 0 for hidden ones, [N]."""
        uv, depth, inside = view.project_into_frame(at, options.radius + 1)
        column, row = (np.where(inside, uv[:, axis], 0).astype(np.int64) for axis in (0, 1))
        shown = cv2.dilate(render_mesh(mesh, view).depth, np.ones((3, 3), np.uint8))[row, column]
        away = view.centre - at
        cosine = np.einsum("ij,ij->i", away, normals) / np.maximum(np.linalg.norm(away, axis=1), 1e-12)
        seen = inside & (shown > 0) & (depth < shown + options.behind * pixel) & (cosine > options.facing)
        return np.where(seen, cosine * pixel * view.fx / np.where(seen, depth, 1.0), 0.0)

    best = np.full((len(at), options.views), -1, np.int32)
    score = np.zeros((len(at), options.views), np.float32)
    each = _BYTES_PER_PIXEL * most_pixels(views) + _BYTES_PER_VERTEX * len(at)
    for number, size in enumerate(parallel_map(sizes, views, bytes_each=each)):
        worst = score.argmin(1)
        better = size > score[rows, worst]
        score[rows[better], worst[better]], best[rows[better], worst[better]] = size[better], number
    return PatchPhotos(views, grey, best, options)


def widest_angle(photos: PatchPhotos, points: Array, vertex: NDArray[np.int64]) -> Array:
    """Return the widest angle between the rays from vertices to the photos that see them best, radians.

    Args:
        photos: what sees the vertices.
        points: all vertices, normalised frame, [N, 3].
        vertex: numbers of the vertices asked for, [M].

    Returns:
        [M]; 0 for a vertex that fewer than two photos see.
    """
    best = photos.best[vertex]
    rays = unit_vectors(np.stack([view.centre for view in photos.views])[best] - points[vertex, None])
    both = (best >= 0)[:, :, None] & (best >= 0)[:, None, :] & ~np.eye(best.shape[1], dtype=bool)
    cosine = np.where(both, np.einsum("mki,mli->mkl", rays, rays), 1.0)
    return np.asarray(np.arccos(np.clip(cosine.min((1, 2)), -1, 1)), np.float64)


def compare_patches(
    photos: PatchPhotos, vertex: NDArray[np.int64], at: Array, normals: Array, pixel: Array
) -> tuple[Array, Array]:
    """Compare the patches at places near vertices between the photos that see those vertices best.

    Args:
        photos: what sees the vertices.
        vertex: the vertex that each place belongs to, [M].
        at: the places, normalised frame, [M, 3].
        normals: unit, of the patches, [M, 3].
        pixel: distance between the places of a patch, [M].

    Returns:
        Correlation of the photo that agrees best with others, [M] (0 where fewer than two see it), and the patch's
        contrast, its second largest standard deviation among the photos in grey levels, [M].
    """

    def piece(begin: int) -> tuple[Array, Array]:
        some = slice(begin, begin + _PIECE)
        patches = _sample(photos, photos.best[vertex[some]], at[some], normals[some], pixel[some])
        return _correlate(patches, photos.best[vertex[some]] >= 0, photos.options)

    parts = list(parallel_map(piece, range(0, len(at), _PIECE)))
    if not parts:
        return np.zeros(0), np.zeros(0)
    return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])


def _sample(
    photos: PatchPhotos, best: NDArray[np.int32], at: Array, normals: Array, pixel: Array
) -> NDArray[np.float32]:
    """Return the brightness of each patch in each of its photos, [M, K, P]; 0 where there is none."""
    other = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    right = unit_vectors(np.cross(normals, other)) * pixel[:, None]
    up = np.cross(normals, right)
    steps = np.arange(-photos.options.radius, photos.options.radius + 1)
    u, v = (grid.ravel() for grid in np.meshgrid(steps, steps))
    patches = np.zeros((*best.shape, len(u)), np.float32)
    for number in np.unique(best[best >= 0]):
        row, k = np.nonzero(best == number)
        places = at[row, None] + u[None, :, None] * right[row, None] + v[None, :, None] * up[row, None]
        uv = photos.views[number].project(places.reshape(-1, 3))[0].astype(np.float32) - np.float32(0.5)
        x, y = (uv[:, axis].reshape(len(row), -1) for axis in (0, 1))
        grey = np.asarray(photos.grey(int(number)))
        patches[row, k] = cv2.remap(grey, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return patches


def _correlate(patches: NDArray[np.float32], seen: NDArray[np.bool_], options: PatchOptions) -> tuple[Array, Array]:
    """Return correlation and contrast of patches [M, K, P], see :func:`compare_patches`."""
    patches = patches - patches.mean(2, keepdims=True)
    variance = np.where(seen, (patches**2).mean(2), 0.0)
    product = np.einsum("mkp,mlp->mkl", patches, patches) / patches.shape[2]
    # noise**2 keeps noise from correlating; the mean variance (not the product) counts a difference in contrast
    correlation = product / ((variance[:, :, None] + variance[:, None, :]) / 2 + options.noise**2)
    both = seen[:, :, None] & seen[:, None, :] & ~np.eye(seen.shape[1], dtype=bool)
    first = -np.sort(-np.where(both, correlation, -np.inf), axis=2)[:, :, : options.partners]
    known = np.isfinite(first)
    mean = np.where(known, first, 0.0).sum(2) / np.maximum(known.sum(2), 1)
    score = np.where(known.any(2), mean, -np.inf).max(1)
    contrast = np.sort(np.sqrt(variance), axis=1)[:, -2]
    return np.where(np.isfinite(score), score, 0.0).astype(np.float64), contrast.astype(np.float64)
