# SPDX-License-Identifier: GPL-3.0-or-later
"""Windows and doors of the solid (LoD3), where they were clicked: rectangles in its walls.

Their borders are those of the elevations (:mod:`mgf_engine.drawings.parts`): what most photos call a window, cut
straight. They lie in the plane of the wall, since the solid's walls are plane, too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import shapely

from mgf_engine.drawings.model import Array, DrawingFrame, Survey
from mgf_engine.drawings.orthophoto import Visibility
from mgf_engine.drawings.parts import PartOutlineOptions, part_shapes, part_shares
from mgf_engine.drawings.project import Grid, plan_grid, render_grid, round_resolution
from mgf_engine.models.solid.checks import faults_of
from mgf_engine.models.solid.model import DOOR, WALL, WINDOW, Solid, SolidFace
from mgf_engine.options.algorithms import parameter
from mgf_engine.texture.texture_pipeline import TextureOptions, choose_painting

KINDS = {"window": WINDOW, "door": DOOR}


@dataclass(frozen=True)
class OpeningOptions:
    """Options of windows and doors."""

    on_wall: float = parameter(0.8, "Minimum share of a rectangle that lies on the wall", high=1)
    wall_distance: float = parameter(2.0, "Largest distance between the mesh in the rectangle and the wall, in details")
    parts: PartOutlineOptions = PartOutlineOptions()
    texture: TextureOptions = TextureOptions()


def add_openings(solid: Solid, survey: Survey, options: OpeningOptions = OpeningOptions()) -> Solid | None:
    """Add windows and doors to the solid as faces of their own; None where none were clicked or none fits a wall."""
    if solid.level < 2 or not any(_kind(name) for name in survey.parts):
        return None
    painting = choose_painting(survey.normalised, survey.scene, survey.masks, options=options.texture)
    visibility = Visibility(survey, painting)
    faces, vertices, openings = list(solid.faces), list(solid.vertices), list[SolidFace]()
    for number, face in enumerate(solid.faces):
        frame = _frame(solid, face) if face.kind == WALL else None
        if frame is None:
            continue
        seen = render_grid(survey, plan_grid(frame, round_resolution(survey.working_pixel)))
        boxes, _ = part_shapes(part_shares(survey, painting, visibility, seen, options.parts), options.parts)
        near = np.abs(seen.before) < options.wall_distance * solid.detail
        holes = []
        for kind, box in _fitting(solid, face, seen.grid, near, boxes, options):
            ring = tuple(range(len(vertices), len(vertices) + 4))
            left, low, right, high = box
            corners = np.array([(left, low, 0), (right, low, 0), (right, high, 0), (left, high, 0)])
            vertices += list(frame.to_local(corners))
            openings.append(SolidFace(kind, (ring,), wall=number))
            holes.append(ring[::-1])
        faces[number] = replace(face, rings=(*face.rings, *holes))
    if not openings:
        return None
    found = replace(solid, vertices=np.array(vertices), faces=faces + openings, level=3)
    return None if faults_of(found, 0.1 * solid.detail) else found


def _kind(name: str) -> str | None:
    return KINDS.get(name.strip().lower().removesuffix("s"))


def _frame(solid: Solid, face: SolidFace) -> DrawingFrame | None:
    """Return the plane of a wall as one sees it from outside; None where it is no upright one."""
    normal, up = solid.normal(face), np.array([0.0, 0.0, 1.0])
    if abs(normal[2]) > 1e-3:
        return None
    points = solid.vertices[list(face.rings[0])]
    frame = DrawingFrame("wall", points[0], np.cross(up, normal), up, np.zeros(2), np.zeros(2))
    at = frame.to_drawing(points)[:, :2]
    return replace(frame, low=at.min(0), high=at.max(0))


def _fitting(
    solid: Solid, face: SolidFace, grid: Grid, near: np.ndarray, boxes: list[tuple[str, Array]], options: OpeningOptions
) -> list[tuple[str, tuple[float, float, float, float]]]:
    """Return the kind and left, low, right, high of the rectangles that lie on a wall, in its drawing coordinates.

    Args:
        near: which pixels of the grid see the mesh near the wall, bool [H, W].
        boxes: name and left, top, right, bottom in pixels.
    """
    outer, *holes = [grid.frame.to_drawing(solid.vertices[list(ring)])[:, :2] for ring in face.rings]
    free = shapely.Polygon(outer, holes).buffer(-grid.resolution)
    found = []
    for name, box in sorted(boxes, key=lambda item: -(item[1][2] - item[1][0]) * (item[1][3] - item[1][1])):
        kind = _kind(name)
        left, top, right, bottom = box
        rows, columns = slice(int(top), int(np.ceil(bottom))), slice(int(left), int(np.ceil(right)))
        if kind is None or near[rows, columns].mean() < options.on_wall:
            continue
        corners = grid.places(np.array([[left, bottom], [right, top]]))
        whole = shapely.box(*corners.ravel())
        part = shapely.box(*whole.intersection(free).bounds) if whole.intersects(free) else shapely.Polygon()
        if part.area < options.on_wall * whole.area or not free.buffer(1e-9).contains(part):
            continue
        found.append((kind, part.bounds))
        free = free.difference(part.buffer(grid.resolution, join_style="mitre"))
    return found
