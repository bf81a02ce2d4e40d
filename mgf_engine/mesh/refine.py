# SPDX-License-Identifier: GPL-3.0-or-later
"""The finished mesh moved to where the photos agree about it.

The depths of a trained field, and the planes on which patches of two photos are compared, are as noisy as its
Gaussians. The mesh is the mean of what all views say, so compared once more on its own planes, in smaller steps,
the photos tell its place more sharply. Only places change: no face comes or goes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.rasterize import render_mesh
from mgf_engine.mesh.colors import vertex_normals
from mgf_engine.mesh.decimate import ground_pixels
from mgf_engine.mesh.photometric import Search, Surface
from mgf_engine.mesh.prior import sight_surface
from mgf_engine.mesh.tsdf import Photos, TsdfField
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import View

SEARCH = Search(9, 0.25)  # within one pixel of parallax
BAND_PIXELS = 1.5  # half width of the band: narrower than at first, because the mesh is nearer to the truth
REACH_PIXELS = 1.0  # a vertex moves this far at most in a round
STEPS = 3  # of the search for the surface along a vertex's normal
SURE = 0.5  # of the band: vertices for which the search ends further from the surface stay
SMOOTHING = 2  # rounds in which each move is drawn half way to those around it


def refine(
    mesh: Mesh,
    views: Sequence[View],
    masks: Sequence[NDArray[np.uint8]],
    photos: Photos,
    rounds: int,
    progress: Callable[[float], None] = lambda share: None,
) -> Mesh:
    """The mesh with its vertices where the photos agree about it.

    Args:
        views: normalised frame.
        masks: per view uint8 [H, W], as :func:`mgf_engine.mesh.hull.judging_mask` makes them.
    """
    for number in range(rounds):
        normals = vertex_normals(mesh)
        field = _matched(mesh, normals, views, masks, photos, lambda share, n=number: progress((n + share) / rounds))  # type: ignore[misc]
        mesh = onto_surface(mesh, normals, field, ground_pixels(mesh, views))
    return mesh


def look_surface(mesh: Mesh, normals: NDArray[np.float64], view: View, grey: NDArray[np.uint8]) -> Surface:
    """What a view sees of the mesh from the front.

    Args:
        normals: unit normal of each face, [F, 3].
        grey: the photo's brightness, [H, W].
    """
    buffers = render_mesh(mesh, view)
    return sight_surface(buffers.depth, buffers.face, normals, view, grey)


def _matched(
    mesh: Mesh,
    vertex_normal: NDArray[np.float64],
    views: Sequence[View],
    masks: Sequence[NDArray[np.uint8]],
    photos: Photos,
    progress: Callable[[float], None],
) -> TsdfField:
    """The mesh as the photos would have it."""
    smoothed = vertex_normal[mesh.faces].mean(1)
    normals = smoothed / np.maximum(np.linalg.norm(smoothed, axis=1, keepdims=True), 1e-12)

    def show(number: int) -> Surface:
        return look_surface(mesh, normals, views[number], photos.grey(number))

    return TsdfField(show, masks, photos.neighbours, SEARCH, BAND_PIXELS, progress, smoothing=photos.smoothing)


def onto_surface(
    mesh: Mesh,
    normals: NDArray[np.float64],
    field: TsdfField,
    pixel: NDArray[np.float32],
    reach: float = REACH_PIXELS,
) -> Mesh:
    """Every vertex moved along its normal onto the surface of ``field``, where that is near enough.

    The moves are smoothed, not the surface: it keeps its edges, and bars of a few pixels do not shrink.

    Args:
        normals: of the vertices, [N, 3].
        pixel: size of a pixel at each vertex, [N].
        reach: pixels that a vertex moves at most.
    """
    shift = np.zeros(len(pixel))
    off = np.full(len(pixel), np.nan, np.float32)
    for _ in range(STEPS):
        off = field.distance(mesh.vertices + shift[:, None] * normals)
        step = np.nan_to_num(off) * field.band * pixel
        shift = np.clip(shift - step, -reach * pixel, reach * pixel)
    shift[~(np.abs(off) < SURE)] = 0.0
    moves, none = shift[:, None] * normals, np.zeros(len(shift), bool)
    for _ in range(SMOOTHING):
        moves = mesh.adjacency.smooth(moves, none)
    return replace(mesh, vertices=mesh.vertices + moves)
