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
    met = parallel_map(lambda given: _met(mesh, *given), clicked)
    hit = np.concatenate([np.zeros(0, np.int32), *met])
    kept = np.isin(np.arange(part.max(initial=-1) + 1), part[hit])
    if not len(hit) or kept.all():
        return np.ones(len(mesh.faces), bool)
    first = mesh.vertices[mesh.faces[kept[part]].ravel()]
    near = options.near * float(np.linalg.norm(first.max(0) - first.min(0)))
    corners = {p: _corners(mesh, rows) for p, rows in enumerate(_members(part)) if not kept[p]}
    new = first
    while len(new):
        tree = cKDTree(new)
        joined = [p for p, points in corners.items() if tree.query(points, distance_upper_bound=near)[0].min() < near]
        new = np.concatenate([np.zeros((0, 3)), *(corners.pop(p) for p in joined)])
        kept[joined] = True
    return np.asarray(kept[part], bool)


def _members(part: NDArray[np.int32]) -> list[NDArray[np.int64]]:
    """Return the faces of each part, by the part of each face [F]."""
    order = np.argsort(part, kind="stable")
    return np.split(order, np.cumsum(np.bincount(part))[:-1])


def _corners(mesh: Mesh, faces: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the corners of some faces, each once, [N, 3]."""
    return mesh.vertices[np.unique(mesh.faces[faces])]


def _met(mesh: Mesh, view: View, clicks: NDArray[np.floating]) -> NDArray[np.int32]:
    """Return the faces hit by clicks [K, 2] in a view, at most [K]."""
    face = render_mesh(mesh, view).face
    met = face[pixel_at(face.shape, clicks)]
    return met[met >= 0]
