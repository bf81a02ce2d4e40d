# SPDX-License-Identifier: GPL-3.0-or-later
"""Choose between field and starting surface at each pixel: the one that photos confirm, else the starting surface.

A field trained on colours wanders where a wall is plain, and its depths are as noisy as its Gaussians; planes through
edges are neither. But planes ignore what stands out from them, and there the photos decide.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mgf_engine.algorithms import parameter
from mgf_engine.geometry.rasterize import face_normals, render_mesh
from mgf_engine.mesh.photometric import Matched, MatchOptions, Surface, match_surface
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import View

Array = NDArray[np.float32]


@dataclass(frozen=True)
class PriorOptions:
    """Options of the choice between the field and the starting surface."""

    same: float = parameter(1.5, "Distance within which two depths show the same surface", "px")
    gain: float = parameter(
        0.05, "Correlation by which photos must prefer the field where a plane is certain, and the plane elsewhere"
    )
    sure: float = parameter(0.3, "Strength (0 to 1) from which a plane is certain", high=1)
    plane_precision: float = parameter(1.0, "Precision of the strongest plane where no photo is matched", "1/px²")
    trust: tuple[float, float] = parameter(
        (0.2, 0.6), "Weight of depths that no photo confirms: everywhere, and in addition on the strongest planes"
    )


@dataclass(frozen=True)
class KnownSurface:
    """What a view shows of a surface known before the field.

    Attributes:
        surface: its depth and normals.
        sure: strength of its planes, 0..1, float32 [H, W].
    """

    surface: Surface
    sure: Array


@dataclass(frozen=True)
class Prior:
    """A surface known before the field.

    Attributes:
        mesh: normalised frame, outward.
        sure: 0..1 for each face, float32 [F].
    """

    mesh: Mesh
    sure: Array

    @cached_property
    def normals(self) -> NDArray[np.float64]:
        """Unit normal of each face, [F, 3]."""
        return face_normals(self.mesh)

    def seen_from(self, view: View, grey: NDArray[np.uint8]) -> KnownSurface:
        """Render the prior from a view, with the photo's brightness [H, W] beside it."""
        buffers = render_mesh(self.mesh, view)
        surface = visible_surface(buffers.depth, buffers.face, self.normals, view, grey)
        sure = np.where(surface.depth > 0, self.sure[np.maximum(buffers.face, 0)], 0).astype(np.float32)
        return KnownSurface(surface, sure)


def visible_surface(
    depth: Array, face: NDArray[np.int32], normals: NDArray[np.float64], view: View, grey: NDArray[np.uint8]
) -> Surface:
    """Render a mesh from a view by depth and face of each pixel; front faces only.

    Args:
        depth: of the mesh at each pixel, [H, W], 0 for none.
        face: at each pixel, int32 [H, W], -1 for none.
        normals: unit normal of each face, [F, 3].
        view: the camera.
        grey: the photo's brightness, [H, W].
    """
    pixels = np.flatnonzero(face >= 0)
    normal = np.zeros((*face.shape, 3), np.float32)
    normal.reshape(-1, 3)[pixels] = normals.take(face.ravel().take(pixels), axis=0) @ view.rotation.T
    u = (np.arange(view.width) + 0.5 - view.cx) / view.fx
    v = (np.arange(view.height) + 0.5 - view.cy) / view.fy
    front = normal[..., 0] * u[None] + normal[..., 1] * v[:, None] + normal[..., 2] < 0
    # Where the mesh has a hole nothing is known: it may be missing there.
    return Surface(view, grey, np.where(front, depth, 0.0).astype(np.float32), normal, np.zeros(face.shape, bool))


def combine_surfaces(field: Surface, known: KnownSurface, options: PriorOptions = PriorOptions()) -> Surface:
    """Combine field and prior: the prior where both are one and its plane is sure, or the field shows nothing.

    Args:
        field: as the field shows it in a view.
        known: as the prior shows it there.
        options: when a plane is certain.
    """
    prior, sure = known.surface, known.sure
    same = np.abs(field.depth - prior.depth) * field.view.fx < options.same * prior.depth
    take = (prior.depth > 0) & ((same & (sure >= options.sure)) | (field.depth == 0))
    depth = np.where(take, prior.depth, field.depth).astype(np.float32)
    normal = np.where(take[..., None], prior.normal, field.normal).astype(np.float32)
    return replace(field, depth=depth, normal=normal, through=field.through & (prior.depth == 0))


def choose_depths(
    field: Surface,
    known: KnownSurface,
    matched: Matched,
    others: Sequence[Surface],
    search: MatchOptions,
    match: Callable[[Surface, Sequence[Surface], MatchOptions], Matched] = match_surface,
    options: PriorOptions = PriorOptions(),
) -> tuple[Surface, Matched]:
    """Choose surface and matched depth of a view, each pixel from the field or from the prior.

    Args:
        field: as :func:`combine_surfaces` gives it.
        known: as the prior shows it in the view.
        matched: the matched depth of ``field``.
        others: what the neighbours show of the prior.
        search: steps of the matching.
        match: matches a surface with its neighbours.
        options: of the choice.
    """
    prior, sure = known.surface, known.sure
    there = prior.depth > 0
    apart = there & (np.abs(field.depth - prior.depth) * field.view.fx >= options.same * prior.depth)
    rival = match(replace(prior, depth=np.where(apart, prior.depth, 0).astype(np.float32)), others, search)
    better = rival.likeness > matched.likeness - np.where(sure >= options.sure, options.gain, -options.gain)
    # A field shows what is behind where its Gaussians leave gaps; the prior, which is closed, does not.
    silent = (matched.likeness == 0) & ((sure > 0) | (prior.depth < field.depth))
    take = apart & np.where(rival.likeness > 0, better, silent)
    depth = np.where(take, rival.depth, matched.depth).astype(np.float32)
    likeness = np.where(take, rival.likeness, matched.likeness).astype(np.float32)
    normal = np.where(take[..., None], prior.normal, field.normal).astype(np.float32)
    here = there & (np.abs(depth - prior.depth) * field.view.fx < options.same * prior.depth)
    trust = np.where(here, options.trust[0] + options.trust[1] * sure, options.trust[0]).astype(np.float32)
    precision = np.where(take, rival.precision, matched.precision)
    precision = np.where((precision == 0) & here, options.plane_precision * sure, precision).astype(np.float32)
    return replace(field, depth=depth, normal=normal), Matched(depth, likeness, precision, matched.parallax, trust)
