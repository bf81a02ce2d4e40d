# SPDX-License-Identifier: GPL-3.0-or-later
"""Find the openings in the walls of a mesh: by their depth behind the planes of walls, and by their edges in photos."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.normals import unit_vectors
from mgf_engine.geometry.patch import faces_over_rectangle
from mgf_engine.geometry.rasterize import render_mesh, render_parallel
from mgf_engine.mesh.cut_openings import OpeningCutOptions, WallOpenings
from mgf_engine.mesh.photo_consistency import PatchOptions
from mgf_engine.mesh.plane_detection import Planes
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import View
from mgf_engine.openings.arches import Proposals
from mgf_engine.openings.detection import Opening, OpeningDetectionOptions, align_edges, openings_in, without_doubles
from mgf_engine.openings.locate import locate_openings
from mgf_engine.openings.photo_edges import EdgePhotos
from mgf_engine.openings.wall_frame import WallFrame
from mgf_engine.options.algorithms import parameter

Array = NDArray[np.float64]
_SPACE = 4.0  # around a wall in its depth map, ground px


@dataclass(frozen=True)
class MeshOpeningOptions:
    """Options of the walls of a mesh that openings are looked for in."""

    area: float = parameter(1500.0, "Minimum area of a wall", "ground px²")
    upright: float = parameter(37.0, "Maximum angle between a wall and up", "degrees", high=90)
    before: float = parameter(1.5, "Distance before a wall up to which the mesh is looked at; balconies are not",
                              "ground px")  # fmt: skip
    pixel: float = parameter(0.5, "Size of a pixel of the map of depths", "ground px", low=0.05)
    longest_side: int = parameter(6000, "Longest side of the map of depths", "px", low=16)
    detection: OpeningDetectionOptions = OpeningDetectionOptions()
    cut: OpeningCutOptions = OpeningCutOptions()


class _Wall(NamedTuple):
    """A wall with the openings that the mesh has in it.

    Attributes:
        frame: of the wall, unit: a ground pixel.
        boxes: left, top, right, bottom of each, y up, [K, 4].
        found: the same in pixels of a map, [K].
        resolution: size of these pixels, ground pixels.
    """

    frame: WallFrame
    boxes: Array
    found: list[Opening]
    resolution: float


def find_wall_openings(
    mesh: Mesh,
    pixel: Array,
    planes: Planes,
    up: Array,
    photos: EdgePhotos,
    options: MeshOpeningOptions = MeshOpeningOptions(),
) -> list[WallOpenings]:
    """Find the openings in all walls, from the largest wall on; no face lies over two of them. Those of a wall that
    turn out to be none are left out.

    Args:
        mesh: normalised frame, its planar parts in their planes.
        pixel: size of a ground pixel at each vertex, [N].
        planes: found on this mesh.
        up: unit, normalised frame, [3].
        photos: to take edges from.
        options: what walls and openings are.
    """
    free, found = np.ones(len(mesh.faces), bool), list[_Wall]()
    for number in np.argsort(-planes.area, kind="stable"):
        normal, area = planes.normals[number], float(planes.area[number])
        if area < options.area or abs(normal @ up) > np.sin(np.radians(options.upright)):
            continue
        own = np.flatnonzero(planes.label == number)
        size = float(np.median(pixel[mesh.faces[own]]))
        frame = _frame(normal, float(planes.offsets[number]), up, size)
        wall = _in_wall(mesh, free, frame, own, area, options)
        if wall is not None:
            found.append(wall)
    return _located(found, photos, options.detection)


def edge_photos(
    mesh: Mesh, views: Sequence[View], photo: Callable[[int], NDArray[np.uint8]], options: PatchOptions = PatchOptions()
) -> EdgePhotos:
    """Return photos for edges of openings; what the mesh hides by more than ``options.behind`` is not shown.

    Args:
        mesh: normalised frame.
        views: cameras.
        photo: number of a view -> RGB uint8 [H, W, 3].
        options: what hides a point.
    """
    last: dict[int, NDArray[np.float32]] = {}

    def shows(number: int, points: Array, normal: Array) -> NDArray[np.bool_]:
        view = views[number]
        if number not in last:
            last.clear()
            last[number] = np.asarray(cv2.dilate(render_mesh(mesh, view).depth, np.ones((3, 3), np.uint8)))
        uv, depth, inside = view.project_into_frame(points, options.radius)
        column, row = (np.where(inside, uv[:, axis], 0).astype(np.int64) for axis in (0, 1))
        shown = last[number][row, column]
        facing = unit_vectors(view.centre - points) @ normal
        near = depth < shown * (1 + options.behind / view.fx)
        return np.asarray(inside & (shown > 0) & near & (facing > options.facing))

    return EdgePhotos(views, photo, shows)


def _frame(normal: Array, offset: float, up: Array, pixel: float) -> WallFrame:
    """Return the frame of a wall with x level, unit: a ground pixel."""
    y = unit_vectors(up - (up @ normal) * normal)
    return WallFrame(offset * normal, pixel * np.stack([np.cross(y, normal), y, normal]))


def _in_wall(
    mesh: Mesh, free: NDArray[np.bool_], frame: WallFrame, own: NDArray[np.int64], area: float, o: MeshOpeningOptions
) -> _Wall | None:
    """Find the openings of a wall by their depth; None without any.

    Args:
        mesh: normalised frame.
        free: faces that lie over no opening of another wall, bool [F]; those over an opening found here are cleared.
        frame: of the wall.
        own: the faces that its plane was found on.
        area: of these, square ground pixels.
        o: options.
    """
    at = frame.coordinates(mesh.vertices)
    corners = at[mesh.faces[own]].reshape(-1, 3)[:, :2]
    low, high = corners.min(0) - _SPACE, corners.max(0) + _SPACE
    resolution = max(o.pixel, float((high - low).max()) / o.longest_side)
    near = np.abs(at[:, 2]) < o.cut.reach
    faces = np.flatnonzero(free & near[mesh.faces[:, 0]] & near[mesh.faces[:, 1]] & near[mesh.faces[:, 2]])
    faces = faces[faces_over_rectangle(at, mesh.faces[faces], low, high)]
    used, corner = np.unique(mesh.faces[faces[(at[mesh.faces[faces], 2] < o.before).all(1)]], return_inverse=True)
    pixels = np.column_stack([(at[used, 0] - low[0]) / resolution, (high[1] - at[used, 1]) / resolution, at[used, 2]])
    width, height = np.ceil((high - low) / resolution).astype(int).tolist()
    seen = render_parallel(pixels, corner.reshape(-1, 3).astype(np.int32), height, width)
    depth = np.where(seen.face >= 0, -seen.depth, np.float32(np.nan))
    found = list(openings_in(depth, 1.0, resolution, area / resolution**2, o.detection))
    found = [found[k] for k in without_doubles(found, o.detection.doubled)]
    if not found:
        return None
    boxes = align_edges(np.array([one.box for one in found]), o.detection.aligned / resolution) * resolution
    boxes = np.tile([low[0], high[1]], 2) + boxes * np.array([1, -1, 1, -1])
    for left, top, right, bottom in boxes:
        over = faces_over_rectangle(at, mesh.faces[faces], np.array([left, bottom]), np.array([right, top]))
        free[faces[over]] = False
    return _Wall(frame, boxes, found, resolution)


def _located(walls: Sequence[_Wall], photos: EdgePhotos, options: OpeningDetectionOptions) -> list[WallOpenings]:
    """Return openings whose edges are where the photos have them, those in one row on one line."""
    if not walls:
        return []
    number = np.repeat(np.arange(len(walls)), [len(wall.boxes) for wall in walls])
    found = [one for wall in walls for one in wall.found]
    rises = np.concatenate([[one.rise * wall.resolution for one in wall.found] for wall in walls])
    proposed = Proposals(
        np.concatenate([wall.boxes for wall in walls]), rises, np.array([one.level for one in found]), number.tolist()
    )
    frames = {k: wall.frame for k, wall in enumerate(walls)}
    boxes, rises, kept = locate_openings(proposed, frames, 1.0, photos, options)
    depths = np.array([one.depth for one in found])
    result = []
    for k, wall in enumerate(walls):
        own = kept & (number == k)
        aligned = align_edges(boxes[own], 0.5 * options.aligned)
        result.append(WallOpenings(wall.frame, aligned, depths[own], rises[own]))
    return [wall for wall in result if len(wall.boxes)]
