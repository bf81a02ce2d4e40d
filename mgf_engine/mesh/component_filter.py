# SPDX-License-Identifier: GPL-3.0-or-later
"""Select the connected components of the mesh that belong to the building.

Components near a clicked one are kept: parts of neighbouring buildings that leaked into the masks are not connected to
what was clicked. Small components are kept if photos confirm them: a chimney is separate if no photo shows the roof.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mgf_engine.geometry.clean import face_areas, large_parts, parts
from mgf_engine.geometry.rasterize import render_mesh
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.pixels import pixel_at
from mgf_engine.model.scene import View
from mgf_engine.native.parallel import parallel_map
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class ComponentFilterOptions:
    """Options of the choice of components."""

    near: float = parameter(
        0.1, "Distance between parts that belong together, as a share of the diagonal of the clicked part", high=1
    )
    confirmed: float = parameter(
        0.001, "Minimum size of a separate part that photos confirm, as a share of the area of the largest part", high=1
    )
    confidence: float = parameter(0.45, "Mean confidence from which photos confirm a separate part", high=1)


def confirmed_parts(
    mesh: Mesh,
    asked: NDArray[np.bool_],
    confidence: Callable[[NDArray[np.float64]], NDArray[np.floating]],
    options: ComponentFilterOptions = ComponentFilterOptions(),
) -> NDArray[np.bool_]:
    """Find the faces of components with high confidence, bool [F].

    Args:
        mesh: in any frame.
        asked: faces of the components that are tested, bool [F].
        confidence: points [N, 3] -> confidence of the surface there, 0..1, [N].
        options: minimum size and confidence.
    """
    rows = np.flatnonzero(asked & large_parts(mesh, options.confirmed))
    result = np.zeros(len(mesh.faces), bool)
    if not len(rows):
        return result
    label, area = parts(mesh)[rows], face_areas(mesh)[rows]
    vertex, corner = np.unique(mesh.faces[rows], return_inverse=True)
    trust = confidence(mesh.vertices[vertex])[corner.reshape(-1, 3)].mean(1)
    mean = np.bincount(label, area * trust) / np.maximum(np.bincount(label, area), 1e-300)
    result[rows] = (mean >= options.confidence)[label]
    return result


def faces_near_clicks(
    mesh: Mesh,
    views: Sequence[View],
    clicks: Sequence[NDArray[np.floating]],
    options: ComponentFilterOptions = ComponentFilterOptions(),
) -> NDArray[np.bool_]:
    """Find the faces of clicked components, and of all that are connected to them by gaps of at most ``near``.

    Args:
        mesh: normalised frame.
        views: cameras of the photos.
        clicks: for each view, the clicks on the building, working pixels [K, 2].
        options: maximum gap.

    Returns:
        bool [F]; all True if no click hits the mesh.
    """
    part = parts(mesh)
    if part.max(initial=0) == 0:
        return np.ones(len(mesh.faces), bool)
    clicked = [(view, spots) for view, spots in zip(views, clicks, strict=True) if len(spots)]
    met = parallel_map(lambda given: _hit_faces(mesh, *given), clicked)
    hit = np.concatenate([np.zeros(0, np.int32), *met])
    kept = np.isin(np.arange(part.max(initial=-1) + 1), part[hit])
    if not len(hit) or kept.all():
        return np.ones(len(mesh.faces), bool)
    vertex, of = _vertices_of_parts(mesh, part)
    new = mesh.vertices[np.unique(vertex[kept[of]])]
    near = options.near * float(np.linalg.norm(new.max(0) - new.min(0)))
    while len(new):
        left = np.flatnonzero(~kept[of])
        gap = cKDTree(new).query(mesh.vertices[vertex[left]], distance_upper_bound=near)[0]
        joined = np.zeros_like(kept)
        joined[of[left[gap < near]]] = True
        new = mesh.vertices[vertex[joined[of]]]
        kept |= joined
    return np.asarray(kept[part], bool)


def _vertices_of_parts(mesh: Mesh, part: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """List the vertices of each part, by the part of each face [F]: vertex and part, [N] each."""
    pair = np.unique(np.repeat(part.astype(np.int64), 3) * len(mesh.vertices) + mesh.faces.ravel())
    of, vertex = np.divmod(pair, len(mesh.vertices))
    return vertex, of


def _hit_faces(mesh: Mesh, view: View, clicks: NDArray[np.floating]) -> NDArray[np.int32]:
    """Return the faces hit by clicks [K, 2] in a view, at most [K]."""
    face = render_mesh(mesh, view).face
    met = face[pixel_at(face.shape, clicks)]
    return met[met >= 0]
