# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks of a solid: is it a closed polyhedron with plane faces, its volume, its faces as triangles."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from mgf_engine.models.solid.model import Solid, plane_axes


def faults_of(solid: Solid, tolerance: float) -> list[str]:
    """List the faults of a solid, in words; none for a closed, oriented, plane-faced 2-manifold with volume."""
    faults, count = [], dict[tuple[int, int], int]()
    for face in solid.faces:
        for ring in face.rings:
            for edge in zip(ring, ring[1:] + ring[:1], strict=True):
                count[edge] = count.get(edge, 0) + 1
    if any(n > 1 for n in count.values()):
        faults.append("an edge belongs to more than two faces")
    if any((v, u) not in count for u, v in count):
        faults.append("an edge belongs to one face only")
    for face in solid.faces:
        points = solid.vertices[[row for ring in face.rings for row in ring]]
        off = (points - points[0]) @ solid.normal(face)
        if np.ptp(off) > tolerance:
            faults.append("a face is not plane")
            break
    if not solid.faces or volume_of(solid) <= 0:
        faults.append("it has no volume")
    return faults


def triangles(solid: Solid) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return triangles between a solid's own vertices [T, 3], and the face of each [T]."""
    rows, owner = list[NDArray[np.int32]](), list[int]()
    for k, face in enumerate(solid.faces):
        axes = plane_axes(solid.normal(face))
        at = {row: solid.vertices[row] @ axes.T for ring in face.rings for row in ring}
        known = {tuple(np.round(place, 7).tolist()): row for row, place in at.items()}
        shape = shapely.Polygon([at[row] for row in face.rings[0]], [[at[r] for r in ring] for ring in face.rings[1:]])
        for part in shapely.constrained_delaunay_triangles(shapely.normalize(shape)).geoms:
            ring = shapely.get_coordinates(shapely.orient_polygons(part).exterior)[:3]
            rows.append(np.array([known[tuple(np.round(place, 7).tolist())] for place in ring], np.int32))
            owner.append(k)
    return np.array(rows, np.int32).reshape(-1, 3), np.array(owner, np.int64)


def volume_of(solid: Solid) -> float:
    """Compute the enclosed volume by the divergence theorem; negative where faces point inwards."""
    origin = solid.vertices.mean(0)
    return sum(
        float((solid.vertices[face.rings[0][0]] - origin) @ solid.normal(face)) * solid.area(face) / 3
        for face in solid.faces
    )
