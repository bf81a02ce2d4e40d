# SPDX-License-Identifier: GPL-3.0-or-later
"""Choose between the depths of the field and of the starting surface (the prior) at each pixel.

The depth with the higher correlation between photos is taken; without texture, that of the prior. On plain walls the
colours do not constrain the field, and its depth is noisy, while the planes of the prior are exact. But these planes
ignore whatever stands out from them: there the photos decide.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.rasterize import face_normals, render_mesh
from mgf_engine.mesh.photometric import Matched, MatchOptions, RenderedSurface, match_surface
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import View
from mgf_engine.options.algorithms import parameter

Array = NDArray[np.float32]


@dataclass(frozen=True)
class PriorOptions:
    """Options of the choice between the field and the starting surface."""

    same: float = parameter(1.5, "Distance within which two depths show the same surface", "px")
    gain: float = parameter(
        0.05, "Correlation by which photos must prefer the field where a plane is certain, and the plane elsewhere"
    )
    least_confidence: float = parameter(0.3, "Minimum confidence (0 to 1) of a plane that counts as certain", high=1)
    plane_precision: float = parameter(1.0, "Precision of the strongest plane where no photo is matched", "1/px²")
    unmatched_weight: tuple[float, float] = parameter(
        (0.2, 0.6), "Weight of depths that no photo confirms: everywhere, and in addition on the strongest planes"
    )


@dataclass(frozen=True)
class RenderedPrior:
    """The prior as rendered from a view.

    Attributes:
        surface: depth and normals.
        confidence: confidence of its planes, 0..1, float32 [H, W].
    """

    surface: RenderedSurface
    confidence: Array


@dataclass(frozen=True)
class Prior:
    """The starting surface as a prior of the depth maps.

    Attributes:
        mesh: normalised frame, faces oriented outward.
        confidence: confidence of the plane of each face, 0..1, float32 [F].
    """

    mesh: Mesh
    confidence: Array

    @cached_property
    def normals(self) -> NDArray[np.float64]:
        """Unit normal of each face, [F, 3]."""
        return face_normals(self.mesh)

    def seen_from(self, view: View, grey: NDArray[np.uint8]) -> RenderedPrior:
        """Render the prior from a view whose photo in grey levels is ``grey``, uint8 [H, W]."""
        buffers = render_mesh(self.mesh, view)
        surface = visible_surface(buffers.depth, buffers.face, self.normals, view, grey)
        confidence = np.where(surface.depth > 0, self.confidence[np.maximum(buffers.face, 0)], 0).astype(np.float32)
        return RenderedPrior(surface, confidence)


def visible_surface(
    depth: Array, face: NDArray[np.int32], normals: NDArray[np.float64], view: View, grey: NDArray[np.uint8]
) -> RenderedSurface:
    """Make the rendered surface of a mesh from its depth and face buffers; back faces count as no surface.

    Args:
        depth: depth buffer, [H, W], 0 for none.
        face: face at each pixel, int32 [H, W], -1 for none.
        normals: unit normal of each face, [F, 3].
        view: the camera.
        grey: the photo in grey levels, uint8 [H, W].
    """
    pixels = np.flatnonzero(face >= 0)
    normal = np.zeros((*face.shape, 3), np.float32)
    normal.reshape(-1, 3)[pixels] = normals.take(face.ravel().take(pixels), axis=0) @ view.rotation.T
    u, v = view.pixel_rays()
    front = normal[..., 0] * u[None] + normal[..., 1] * v[:, None] + normal[..., 2] < 0
    # A hole in the mesh is no evidence of free space: the surface may be missing there.
    return RenderedSurface(
        view, grey, np.where(front, depth, 0.0).astype(np.float32), normal, np.zeros(face.shape, bool)
    )


def combine_surfaces(
    field: RenderedSurface, known: RenderedPrior, options: PriorOptions = PriorOptions()
) -> RenderedSurface:
    """Combine field and prior: the prior where both agree and its plane is certain, or the field shows no surface.

    Args:
        field: surface rendered from the field.
        known: the prior rendered from the same view.
        options: when depths agree, and when a plane is certain.
    """
    prior, confidence = known.surface, known.confidence
    same = np.abs(field.depth - prior.depth) * field.view.fx < options.same * prior.depth
    take = (prior.depth > 0) & ((same & (confidence >= options.least_confidence)) | (field.depth == 0))
    depth = np.where(take, prior.depth, field.depth).astype(np.float32)
    normal = np.where(take[..., None], prior.normal, field.normal).astype(np.float32)
    return replace(field, depth=depth, normal=normal, free_space=field.free_space & (prior.depth == 0))


def choose_depths(
    field: RenderedSurface,
    known: RenderedPrior,
    matched: Matched,
    others: Sequence[RenderedSurface],
    search: MatchOptions,
    match: Callable[[RenderedSurface, Sequence[RenderedSurface], MatchOptions], Matched] = match_surface,
    options: PriorOptions = PriorOptions(),
) -> tuple[RenderedSurface, Matched]:
    """Choose surface and matched depth of a view, for each pixel from the field or from the prior.

    Args:
        field: as :func:`combine_surfaces` returns it.
        known: the prior rendered from the view.
        matched: the matched depth of ``field``.
        others: the prior rendered from the neighbouring views.
        search: options of the matching.
        match: matches a surface with its neighbours.
        options: of the choice.

    Returns:
        The chosen surface, and its matched depth.
    """
    prior, confidence = known.surface, known.confidence
    there = prior.depth > 0
    apart = there & (np.abs(field.depth - prior.depth) * field.view.fx >= options.same * prior.depth)
    rival = match(replace(prior, depth=np.where(apart, prior.depth, 0).astype(np.float32)), others, search)
    better = rival.correlation > matched.correlation - np.where(
        confidence >= options.least_confidence, options.gain, -options.gain
    )
    # Without a match the prior wins if it is nearer: gaps between Gaussians show what is behind; the prior has no gaps.
    silent = (matched.correlation == 0) & ((confidence > 0) | (prior.depth < field.depth))
    take = apart & np.where(rival.correlation > 0, better, silent)
    depth = np.where(take, rival.depth, matched.depth).astype(np.float32)
    correlation = np.where(take, rival.correlation, matched.correlation).astype(np.float32)
    normal = np.where(take[..., None], prior.normal, field.normal).astype(np.float32)
    here = there & (np.abs(depth - prior.depth) * field.view.fx < options.same * prior.depth)
    weight = np.where(
        here, options.unmatched_weight[0] + options.unmatched_weight[1] * confidence, options.unmatched_weight[0]
    ).astype(np.float32)
    precision = np.where(take, rival.precision, matched.precision)
    precision = np.where((precision == 0) & here, options.plane_precision * confidence, precision).astype(np.float32)
    return replace(field, depth=depth, normal=normal), Matched(depth, correlation, precision, matched.parallax, weight)
