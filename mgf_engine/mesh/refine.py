# SPDX-License-Identifier: GPL-3.0-or-later
"""Photometric mesh refinement: move the vertices to where patches of the photos correlate best.

Depths rendered from the field, and the tangent planes of their patches, are as noisy as the Gaussians. The fused mesh
is smoother, so patch matching on its faces, in smaller steps, is more accurate. Only vertices move; the faces stay.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.normals import vertex_normals
from mgf_engine.geometry.rasterize import render_mesh
from mgf_engine.mesh.depth_maps import ViewSurfaces, make_depth_maps
from mgf_engine.mesh.fusion_options import FusionOptions
from mgf_engine.mesh.ground_pixels import ground_pixels
from mgf_engine.mesh.photometric import RenderedSurface
from mgf_engine.mesh.prior import visible_surface
from mgf_engine.mesh.trusted_views import Photos, TrustedViews
from mgf_engine.mesh.tsdf import TsdfField
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import View
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class RefinementOptions:
    """Options of photometric mesh refinement."""

    steps: int = parameter(9, "Number of depths that are tried at each pixel; odd", low=3, high=99)
    pixels: float = parameter(0.25, "Parallax between two tried depths", "px", low=1e-3)
    band: float = parameter(1.5, "Half width of the band in which distances are known", "px", low=1e-3)
    reach: float = parameter(1.0, "Maximum distance that a vertex moves in a round", "px")
    search_steps: int = parameter(3, "Number of steps of the search for the surface along a vertex's normal")
    search_tolerance: float = parameter(
        0.5, "Distance from the surface, as a share of the band, beyond which a search has failed", high=1
    )
    smoothing: int = parameter(2, "Number of rounds that smooth the moves of the vertices")

    def narrow(self, fusion: FusionOptions) -> FusionOptions:
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
    """Render depth maps of a mesh, match and fuse them, and move the vertices onto the result; repeat.

    Args:
        mesh: normalised frame.
        trusted: photos and masks; without photos to match the mesh is returned unchanged.
        rounds: number of repetitions.
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

        field = _fuse_matched(mesh, normals, trusted, trusted.photos, report, options.narrow(fusion))
        mesh = project_onto_surface(mesh, normals, field, ground_pixels(mesh, trusted.views), options)
    return mesh


def render_mesh_surface(
    mesh: Mesh, normals: NDArray[np.float64], view: View, grey: NDArray[np.uint8]
) -> RenderedSurface:
    """Render the front faces of the mesh from a view.

    Args:
        mesh: normalised frame.
        normals: unit normal of each face, [F, 3].
        view: the camera.
        grey: the photo in grey levels, uint8 [H, W].
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

    def show(number: int) -> RenderedSurface:
        return render_mesh_surface(mesh, normals, trusted.views[number], photos.grey(number))

    maps = make_depth_maps(ViewSurfaces(show), trusted.silhouettes, photos.neighbours, options, progress)
    return TsdfField(maps, options.tsdf)


def project_onto_surface(
    mesh: Mesh,
    normals: NDArray[np.float64],
    field: TsdfField,
    pixel: NDArray[np.float32],
    options: RefinementOptions = RefinementOptions(),
) -> Mesh:
    """Move each vertex along its normal onto the zero level of a signed distance, if that is near enough.

    The displacements are smoothed, not the surface, so that edges stay sharp and bars of a few pixels do not shrink.

    Args:
        mesh: normalised frame.
        normals: unit normals of the vertices, [N, 3].
        field: the signed distance.
        pixel: size of a ground pixel at each vertex, [N].
        options: reach, steps and smoothing.
    """
    shift, reach = np.zeros(len(pixel)), options.reach
    off = np.full(len(pixel), np.nan, np.float32)
    for _ in range(options.search_steps):
        off = field.distance(mesh.vertices + shift[:, None] * normals)
        step = np.nan_to_num(off) * field.band * pixel
        shift = np.clip(shift - step, -reach * pixel, reach * pixel)
    shift[~(np.abs(off) < options.search_tolerance)] = 0.0
    moves, none = shift[:, None] * normals, np.zeros(len(shift), bool)
    for _ in range(options.smoothing):
        moves = mesh.adjacency.smooth(moves, none)
    return replace(mesh, vertices=mesh.vertices + moves)
