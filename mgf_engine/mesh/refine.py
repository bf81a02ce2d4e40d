# SPDX-License-Identifier: GPL-3.0-or-later
"""Refine the finished mesh: move it to where the photos agree about it.

The depths of a trained field, and the planes on which patches of two photos are compared, are as noisy as its
Gaussians. The mesh is the mean of all depth maps: patches on its own faces, compared in smaller steps, place it more
precisely. Only vertices move; no face is added or removed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mgf_engine.algorithms import parameter
from mgf_engine.geometry.rasterize import render_mesh
from mgf_engine.mesh.colors import vertex_normals
from mgf_engine.mesh.decimate import ground_pixels
from mgf_engine.mesh.depth_maps import ViewSurfaces, make_depth_maps
from mgf_engine.mesh.fusion_options import FusionOptions
from mgf_engine.mesh.photometric import Surface
from mgf_engine.mesh.prior import visible_surface
from mgf_engine.mesh.trusted_views import Photos, TrustedViews
from mgf_engine.mesh.tsdf import TsdfField
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import View


@dataclass(frozen=True)
class RefinementOptions:
    """Options of photometric mesh refinement."""

    steps: int = parameter(9, "Number of depths that are tried at each pixel; odd", low=3, high=99)
    pixels: float = parameter(0.25, "Parallax between two tried depths", "px", low=1e-3)
    band: float = parameter(1.5, "Half width of the band in which distances are known", "px", low=1e-3)
    reach: float = parameter(1.0, "Maximum distance that a vertex moves in a round", "px")
    search_steps: int = parameter(3, "Number of steps of the search for the surface along a vertex's normal")
    sure: float = parameter(
        0.5, "Distance from the surface, as a share of the band, beyond which a search has failed", high=1
    )
    smoothing: int = parameter(2, "Number of rounds that smooth the moves of the vertices")

    def narrowed(self, fusion: FusionOptions) -> FusionOptions:
        """Narrow the options of the fusion to the steps and the band of the refinement."""
        match = replace(fusion.match, steps=self.steps, pixels=self.pixels)
        return replace(fusion, match=match, tsdf=replace(fusion.tsdf, band=self.band))


def refine(
    mesh: Mesh,
    trusted: TrustedViews,
    rounds: int,
    progress: Callable[[float], None] = lambda share: None,
    fusion: FusionOptions = FusionOptions(),
    options: RefinementOptions = RefinementOptions(),
) -> Mesh:
    """Move the vertices of a mesh to where the photos agree about them.

    Args:
        mesh: normalised frame.
        trusted: photos and masks; without photos to match the mesh stays as it is.
        rounds: number of times.
        progress: called with the share that is done.
        fusion: options of the matching, the smoothing and the fusion.
        options: of the refinement.
    """
    if trusted.photos is None:
        return mesh
    for number in range(rounds):
        normals = vertex_normals(mesh)

        def report(share: float, done: int = number) -> None:
            progress((done + share) / rounds)

        field = _fuse_matched(mesh, normals, trusted, trusted.photos, report, options.narrowed(fusion))
        mesh = onto_surface(mesh, normals, field, ground_pixels(mesh, trusted.views), options)
    return mesh


def render_surface(mesh: Mesh, normals: NDArray[np.float64], view: View, grey: NDArray[np.uint8]) -> Surface:
    """Render the front of the mesh in a view.

    Args:
        mesh: normalised frame.
        normals: unit normal of each face, [F, 3].
        view: the camera.
        grey: the photo's brightness, [H, W].
    """
    buffers = render_mesh(mesh, view)
    return visible_surface(buffers.depth, buffers.face, normals, view, grey)


def _fuse_matched(
    mesh: Mesh,
    vertex_normal: NDArray[np.float64],
    trusted: TrustedViews,
    photos: Photos,
    progress: Callable[[float], None],
    options: FusionOptions,
) -> TsdfField:
    """Match the depths of the mesh between the photos, and fuse them into a signed distance."""
    smoothed = vertex_normal[mesh.faces].mean(1)
    normals = smoothed / np.maximum(np.linalg.norm(smoothed, axis=1, keepdims=True), 1e-12)

    def show(number: int) -> Surface:
        return render_surface(mesh, normals, trusted.views[number], photos.grey(number))

    maps = make_depth_maps(ViewSurfaces(show), trusted.verdicts, photos.neighbours, options, progress)
    return TsdfField(maps, options.tsdf)


def onto_surface(
    mesh: Mesh,
    normals: NDArray[np.float64],
    field: TsdfField,
    pixel: NDArray[np.float32],
    options: RefinementOptions = RefinementOptions(),
) -> Mesh:
    """Move every vertex along its normal onto the surface of ``field``, where that is near enough.

    The moves are smoothed, not the surface: it keeps its edges, and bars of a few pixels do not shrink.

    Args:
        mesh: normalised frame.
        normals: of the vertices, [N, 3].
        field: whose surface it is.
        pixel: size of a pixel at each vertex, [N].
        options: reach, steps and smoothing.
    """
    shift, reach = np.zeros(len(pixel)), options.reach
    off = np.full(len(pixel), np.nan, np.float32)
    for _ in range(options.search_steps):
        off = field.distance(mesh.vertices + shift[:, None] * normals)
        step = np.nan_to_num(off) * field.band * pixel
        shift = np.clip(shift - step, -reach * pixel, reach * pixel)
    shift[~(np.abs(off) < options.sure)] = 0.0
    moves, none = shift[:, None] * normals, np.zeros(len(shift), bool)
    for _ in range(options.smoothing):
        moves = mesh.adjacency.smooth(moves, none)
    return replace(mesh, vertices=mesh.vertices + moves)
