# SPDX-License-Identifier: GPL-3.0-or-later
"""Data classes of the drawings: the survey of a job, and the planes it is drawn on."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from shapely import Polygon

from mgf_engine.geometry.clean import face_areas
from mgf_engine.geometry.rasterize import face_normals
from mgf_engine.georef.model import Georeference
from mgf_engine.mesh.parts import Elements
from mgf_engine.model.masks import MaskSet
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import Scene

Array = NDArray[np.float64]
#: Of a normal against the horizon, up to which a face is part of a wall.
LEANING = float(np.sin(np.radians(12.0)))


@dataclass(frozen=True)
class DrawingFrame:
    """A plane to draw on, seen from outside; lengths in the unit of the local frame.

    Attributes:
        name: for file names, such as ``north`` or ``A``.
        origin: of the drawing, on the plane, local frame [3].
        x, y: unit axes in the plane, to the right and upwards as one sees it, local frame [3].
        low, high: corners of what is drawn, in the drawing's own coordinates [2].
    """

    name: str
    origin: Array
    x: Array
    y: Array
    low: Array
    high: Array

    @property
    def normal(self) -> Array:
        """Unit normal towards whoever looks at the drawing, [3]."""
        return np.cross(self.x, self.y)

    @property
    def from_above(self) -> bool:
        """Whether it is seen from straight above, as plans and roofs are."""
        return bool(self.normal[2] > 0.999999)

    @property
    def size(self) -> Array:
        """Width and height, [2]."""
        return self.high - self.low

    def to_drawing(self, points: Array) -> Array:
        """Convert local frame [..., 3] to x, y and the distance before the plane, [..., 3]."""
        return (points - self.origin) @ np.stack([self.x, self.y, self.normal], 1)

    def to_local(self, points: Array) -> Array:
        """Convert x, y and distance before the plane [..., 3] to the local frame [..., 3]."""
        return self.origin + points @ np.stack([self.x, self.y, self.normal])


@dataclass(frozen=True)
class Facade:
    """A side of the building.

    Attributes:
        frame: vertical, through the facade's largest wall plane; y is the height in the local frame.
        direction: of the outward normal in degrees clockwise from the local frame's y axis (north where it is known).
        wall: faces of the largest wall plane, rows of the mesh.
        tilt: degrees by which that plane leans outwards at its top, negative inwards.
    """

    frame: DrawingFrame
    direction: float
    wall: NDArray[np.int64]
    tilt: float

    @property
    def name(self) -> str:
        return self.frame.name


@dataclass(frozen=True)
class Survey:
    """What a job knows about its building.

    Attributes:
        mesh: in the local frame.
        normalised: the same mesh in the frame of the scene's views.
        scene, masks: of the job.
        parts: named parts (window, door ...) -> the elements of the masks that show them.
        georeference: of the job.
        turn: local frame of the georeference -> local frame of the drawings, [3, 3]; a rotation that puts up where it
            was not known.
        pixel: length that a pixel of the photos as they were taken covers on the building, in the local unit.
        working_pixel: the same of the working photos, which the mesh was made from.
    """

    mesh: Mesh
    normalised: Mesh
    scene: Scene
    masks: MaskSet
    parts: dict[str, Elements]
    georeference: Georeference
    turn: Array
    pixel: float
    working_pixel: float

    @cached_property
    def normals(self) -> Array:
        """Outward unit normals of the faces in the local frame, [F, 3]."""
        return face_normals(self.mesh)

    @cached_property
    def normals_normalised(self) -> Array:
        """The same in the normalised frame, [F, 3]."""
        return self.turn_to_normalised(self.normals)

    @cached_property
    def areas(self) -> Array:
        """Areas of the faces, [F]."""
        return face_areas(self.mesh)

    @cached_property
    def centres(self) -> Array:
        """Middles of the faces, [F, 3]."""
        return np.asarray(self.mesh.vertices[self.mesh.faces].mean(1))

    @property
    def unit(self) -> str:
        """The unit as it stands behind a number: ``m``, or ``units`` where nobody knows the scale."""
        return self.georeference.unit_name

    def local(self, scene_points: Array) -> Array:
        """Convert scene frame [..., 3] to local frame of the drawings [..., 3]."""
        return np.asarray(self.georeference.local(scene_points) @ self.turn.T)

    def normalise(self, points: Array) -> Array:
        """Convert local frame of the drawings [..., 3] to normalised frame [..., 3]."""
        return self.scene.to_normalised.apply(self.georeference.scene(points @ self.turn))

    def turn_to_normalised(self, directions: Array) -> Array:
        """Convert directions of the local frame of the drawings [..., 3] to the normalised frame [..., 3]."""
        turn = self.turn @ self.georeference.rotation @ self.scene.to_normalised.rotation.T
        return np.asarray(directions @ turn)

    def world(self, points: Array) -> Array:
        """Convert the points of the local frame of the drawings [..., 3] to coordinates of the CRS, or of the scene
        without one, [..., 3]."""
        return np.asarray(points @ self.turn + np.array(self.georeference.offset))


@dataclass(frozen=True)
class Polyline:
    """A polyline of a drawing.

    Attributes:
        points: drawing coordinates, [n, 2]; the first is repeated at the end where the line is closed.
        layer: what it is, one of :data:`LAYERS`, or ``PART-NAME`` for the outline of a named part.
    """

    points: Array
    layer: str


@dataclass(frozen=True)
class LineDrawing:
    """Lines on a frame.

    Attributes:
        areas: what a section cuts through, to be hatched; drawing coordinates.
        openings: windows, doors and bays that are drawn as rectangles: left, low, right, high in the drawing [4].
    """

    frame: DrawingFrame
    lines: list[Polyline]
    areas: list[Polygon]
    openings: list[Array] = field(default_factory=list)


def rings_of(area: Polygon) -> list[Array]:
    """Return the outer ring and the holes of an area, [n, 2] each, the first point again at the end."""
    return [np.asarray(ring.coords) for ring in (area.exterior, *area.interiors)]


#: Layers of line drawings and their pen widths in millimetres, heaviest first.
OUTLINE, CUT, STEP, CREASE, DETAIL, HATCH = "OUTLINE", "CUT", "STEP", "CREASE", "DETAIL", "HATCH"
PART = "PART-"
LAYERS = {CUT: 0.5, OUTLINE: 0.5, STEP: 0.35, CREASE: 0.25, PART: 0.25, DETAIL: 0.13, HATCH: 0.13}


def pen_width(layer: str) -> float:
    """Return the pen width in millimetres on paper."""
    return LAYERS[PART if layer.startswith(PART) else layer]
