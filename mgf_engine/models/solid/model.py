# SPDX-License-Identifier: GPL-3.0-or-later
"""Data classes of a solid: plane faces with rings of corners; areas and normals of rings."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mgf_engine.drawings.ground import MESH
from mgf_engine.models.lod import Deviation

Array = NDArray[np.float64]
ROOF, WALL, GROUND = "roof", "wall", "ground"
WINDOW, DOOR = "window", "door"


@dataclass(frozen=True)
class SolidFace:
    """A plane face.

    Attributes:
        kind: :data:`ROOF`, :data:`WALL`, :data:`GROUND`, :data:`WINDOW` or :data:`DOOR`.
        rings: rows of vertices, the outer ring first, counter-clockwise seen from outside, holes the other way.
        plane: number of the roof plane, -1 for all others.
        wall: row of the face that a window or door lies in, -1 for all others.
    """

    kind: str
    rings: tuple[tuple[int, ...], ...]
    plane: int = -1
    wall: int = -1


@dataclass(frozen=True)
class Solid:
    """A closed polyhedron in the local frame.

    Attributes:
        vertices: [N, 3].
        faces: all of them.
        level: 2, 3 with windows and doors, or 1 for a block with a level top where the roof was not seen.
        ground: height of the ground.
        ground_from: :data:`~mgf_engine.drawings.ground.TERRAIN` or `MESH`, which tells it.
        detail: size below which steps and offsets were left out.
        volume: in cubic units.
        deviation: of the mesh above the ground from the solid.
        unseen: share of the area of each kind of face that no mesh lies near; party walls do not count.
        party: share of the area of the walls that lies against neighbours.
    """

    vertices: Array
    faces: list[SolidFace]
    level: int = 2
    ground: float = 0.0
    ground_from: str = MESH
    detail: float = 0.0
    volume: float = 0.0
    deviation: Deviation | None = None
    unseen: dict[str, float] = field(default_factory=dict)
    party: float = 0.0

    def normal(self, face: SolidFace) -> Array:
        """Return outward unit normal of a face, [3] (Newell)."""
        return ring_normal(self.vertices[list(face.rings[0])])

    def area(self, face: SolidFace) -> float:
        """Return the area of a face without its holes."""
        return abs(sum(float(self.normal(face) @ ring_vector(self.vertices[list(ring)])) for ring in face.rings))


def ring_vector(points: Array) -> Array:
    """Return the normal of a ring [n, 3], as long as its area, [3]."""
    local = points - points[0]
    return np.asarray(0.5 * np.cross(local, np.roll(local, -1, axis=0)).sum(0))


def ring_normal(points: Array) -> Array:
    """Return unit normal of a ring [n, 3], [3]."""
    vector = ring_vector(points)
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-300))


def plane_axes(normal: Array) -> Array:
    """Return two unit axes in a plane, [2, 3], counter-clockwise seen from where its normal points."""
    helper = np.eye(3)[int(np.abs(normal).argmin())]
    x = np.cross(helper, normal)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(normal, x)])


def signed_ring_area(ring: Array) -> float:
    """Return the area of a ring [n, 2], negative where it runs clockwise."""
    x, y = (ring - ring[0]).T
    return 0.5 * float(x @ np.roll(y, -1) - np.roll(x, -1) @ y)
