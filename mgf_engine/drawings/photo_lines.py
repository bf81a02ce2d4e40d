# SPDX-License-Identifier: GPL-3.0-or-later
"""Move lines of a drawing to where the photos have the edges of planes.

The mesh goes round gently at eaves, verges and corners, so that the border of a region lies some pixels beside the
edge. The plane on its nearer side is known better. The photos are sampled on that plane, in strips across the line, as
for edges of openings (:mod:`mgf_engine.openings.photo_edges`): the edge of the plane has its gradient at one place in
all photos, while what lies behind moves with the camera.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.drawings.line_planes import EdgeOfPlane, edge_of_plane
from mgf_engine.drawings.model import Array, Survey
from mgf_engine.drawings.regions import RegionMap
from mgf_engine.drawings.straighten import FittedSegment, StraightenOptions, Stroke, crossing
from mgf_engine.drawings.trace import Chain
from mgf_engine.geometry.normals import unit_vectors
from mgf_engine.geometry.rasterize import render_mesh
from mgf_engine.model.masks import building
from mgf_engine.openings.photo_edges import ALONG, STEP, EdgePhotos, EdgeStrip, mean_gradients
from mgf_engine.openings.wall_frame import WallFrame
from mgf_engine.options.algorithms import parameter
from mgf_engine.texture.painting import Painting

_AROUND = np.ones((3, 3), np.uint8)
_RIDGE = 0.1  # keeps corners in place along lines, of which two may be nearly parallel


@dataclass(frozen=True)
class PhotoLineOptions:
    """Options of the lines that are moved to where photos have the edges of planes."""

    least: float = parameter(12.0, "Minimum length of a line that is moved", "ground px")
    ends: float = parameter(4.0, "Length at both ends of a line that is not looked at, 15 % at most", "ground px")
    piece: float = parameter(
        12.0, "Length of the pieces of a line whose gradients are taken each by itself", "ground px"
    )
    reach: float = parameter(9.0, "Distance from a line within which gradients are looked at", "ground px")
    spread: float = parameter(3.5, "Standard deviation of the edge's distance from the mesh's", "ground px", low=0.01)
    farthest: float = parameter(8.0, "Maximum distance of the edge from the mesh's", "ground px")
    spread_known: float = parameter(1.2, "Standard deviation of its distance from a line that planes give", "ground px",
                                    low=0.01)  # fmt: skip
    farthest_known: float = parameter(2.0, "Maximum distance from a line that planes give", "ground px")
    overhang: float = parameter(
        14.0, "Maximum distance of eaves beyond the line at which the mesh has the roof end", "ground px"
    )
    spread_eaves: float = parameter(8.0, "Standard deviation of that distance", "ground px", low=0.01)
    roof: tuple[float, float] = parameter((10.0, 75.0), "Least and largest slope of a roof, which has eaves", "degrees",
                                          high=90)  # fmt: skip
    contrast: float = parameter(0.25, "Minimum mean gradient of the edge; the largest in each photo is 1", high=1)
    same_line: float = parameter(0.6, "Distance within which level or upright lines are one and move together",
                                 "ground px")  # fmt: skip
    shown: float = parameter(
        0.5, "Minimum share of a piece that a photo shows, and of the pieces that any does", high=1
    )
    blur: float = parameter(0.4, "Standard deviation of the filter along a strip", "ground px")
    inner: float = parameter(1.0, "Weight of a photo that looks at what is beyond the edge; 1 for one that does not",
                             high=1)  # fmt: skip
    behind: float = parameter(4.0, "Distance behind the nearest surface up to which a point is seen", "ground px")
    facing: float = parameter(0.17, "Minimum cosine between the plane's normal and the ray to the camera", high=1)


class Move(NamedTuple):
    """How a line moves, drawing coordinates.

    Attributes:
        across: unit vector, [2].
        distance: along it.
        along: unit direction of the line that was moved, [2]; eaves are turned.
    """

    across: Array
    distance: float
    along: Array

    @property
    def vector(self) -> Array:
        """The move as a vector, [2]."""
        return self.distance * self.across


def line_photos(survey: Survey, painting: Painting, options: PhotoLineOptions = PhotoLineOptions()) -> EdgePhotos:
    """Return the photos of a painting, at their working size, for edges of planes, with what is beside the mesh.

    A photo shows a point where the mesh hides none of it, and, if the point lies on the mesh, its mask is building.

    Args:
        survey: mesh and masks of the job.
        painting: the photos.
        options: what hides a point.
    """
    last: dict[int, tuple[NDArray[np.float32], NDArray[np.bool_]]] = {}

    def shows(k: int, points: Array, normal: Array) -> NDArray[np.bool_]:
        view = painting.views[k]
        if k not in last:
            last.clear()
            depth = cv2.dilate(render_mesh(survey.normalised, view).depth, _AROUND)
            last[k] = np.asarray(depth, np.float32), building(survey.masks.labels[painting.chosen[k]])
        nearest, mask = last[k]
        uv, depth, inside = view.project_into_frame(points, 1)
        column, row = (np.where(inside, uv[:, axis], 0).astype(np.int64) for axis in (0, 1))
        surface, reach = nearest[row, column], options.behind / view.fx
        before = (surface == 0) | (depth < surface * (1 - reach))  # of the mesh: beyond the edge
        on_mesh = (depth < surface * (1 + reach)) & mask[row, column]
        facing = unit_vectors(view.centre - points) @ normal > options.facing
        return np.asarray(inside & facing & (before | on_mesh))

    return EdgePhotos(painting.views, lambda k: survey.scene.photo(painting.chosen[k]), shows)


def plane_frame(regions: RegionMap, label: int, survey: Survey) -> WallFrame:
    """Return the coordinates of a region's plane whose x and y are those of the drawing."""
    at = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    corners = survey.normalise(regions.grid.frame.to_local(np.column_stack([at, regions.before(label, at)])))
    x, y = corners[1:] - corners[0]
    normal = np.cross(x, y)
    return WallFrame(corners[0], np.stack([x, y, normal / np.sqrt(np.linalg.norm(normal))]))


class _Line(NamedTuple):
    """A segment of a stroke that an edge is looked for at.

    Attributes:
        stroke: number of the stroke.
        segment: number of the segment in it.
        edge: the segment, and its plane.
        pieces: numbers of its strips.
    """

    stroke: int
    segment: int
    edge: EdgeOfPlane
    pieces: range

    @property
    def place(self) -> float:
        """Where it lies across itself, towards its plane."""
        return float(self.edge.segment.at @ self.edge.across)


def find_moves(
    lines: Sequence[tuple[Stroke, Chain]],
    regions: RegionMap,
    survey: Survey,
    photos: EdgePhotos,
    options: PhotoLineOptions = PhotoLineOptions(),
    foot: Array | None = None,
) -> list[dict[int, Move]]:
    """Find how far the segments of strokes lie from the edges of planes in the photos.

    Args:
        lines: strokes, and the borders that they are of.
        regions: of the drawing.
        survey: converts to the normalised frame.
        photos: to look at.
        options: limits.
        foot: the line of the ground as :func:`mgf_engine.drawings.plane_lines.plane_lines` has them, [1, 5]; segments
            on it stay.

    Returns:
        For each stroke the moves of those segments that an edge was found for; level or upright ones on one line move
        together.
    """
    pixel = survey.working_pixel
    found, strips = _find_lines(lines, regions, survey, options, foot)
    curves = mean_gradients(strips, photos, options)
    moves: list[dict[int, Move]] = [{} for _ in lines]
    for group in _on_one_line(found, options.same_line * pixel):
        distance = _distance_of(group, curves, options)
        if distance is None:
            continue
        place = np.average([line.place for line in group], weights=[len(line.pieces) for line in group])
        for line in group:
            off = float(place) - line.place if len(group) > 1 else 0.0
            moves[line.stroke][line.segment] = Move(line.edge.across, distance * pixel + off, line.edge.segment.along)
    return moves


def _offsets(eaves: bool, options: PhotoLineOptions) -> Array:
    """Return the distances from a line at which gradients are looked at, ground pixels [n]; of eaves farther out."""
    offsets = np.arange(-options.reach, options.reach + 0.5 * STEP, STEP)
    return offsets - (options.overhang + 1.0 - options.reach) * eaves


def _find_lines(
    lines: Sequence[tuple[Stroke, Chain]],
    regions: RegionMap,
    survey: Survey,
    options: PhotoLineOptions,
    foot: Array | None,
) -> tuple[list[_Line], list[EdgeStrip]]:
    """Return the segments that are the edge of a plane, and the strips of all; arguments of :func:`find_moves`."""
    pixel, found, strips = survey.working_pixel, list[_Line](), list[EdgeStrip]()
    for row, (stroke, chain) in enumerate(lines):
        for k, segment in enumerate(stroke.segments):
            ends = stroke.points[k : k + 2]
            if np.hypot(*(ends[1] - ends[0])) < options.least * pixel or _is_on(foot, ends, 0.1 * pixel):
                continue
            edge = edge_of_plane(segment, ends, chain, regions, pixel, options.roof)
            if edge is None:
                continue
            frame, offsets = plane_frame(regions, edge.label, survey), _offsets(edge.eaves, options)
            pieces = _strips(edge.ends, edge.across, frame, pixel, offsets, options)
            found.append(_Line(row, k, edge, range(len(strips), len(strips) + len(pieces))))
            strips += pieces
    return found, strips


def _distance_of(group: Sequence[_Line], curves: Array, options: PhotoLineOptions) -> float | None:
    """Return how far an edge lies from lines in a row, ground pixels; None where the photos show none.

    Args:
        group: the lines.
        curves: mean gradients of all strips [S, n], NaN for those that no photo shows.
        options: limits.
    """
    rows = [piece for line in group for piece in line.pieces]
    known = curves[rows][np.isfinite(curves[rows, 0])]
    if len(known) < options.shown * len(rows):
        return None
    eaves = group[0].edge.eaves
    if eaves:
        limits = options.spread_eaves, options.overhang
    elif any(line.edge.segment.known for line in group):
        limits = options.spread_known, options.farthest_known
    else:
        limits = options.spread, options.farthest
    return _edge_in(known.mean(0), _offsets(eaves, options), *limits, options.contrast)


def _is_on(line: Array | None, ends: Array, near: float) -> bool:
    """Tell whether both ends [2, 2] of a segment are within a distance of a line [1, 5]."""
    return line is not None and bool((np.abs(ends @ line[0, :2] + line[0, 2]) < near).all())


def _on_one_line(lines: Sequence[_Line], apart: float) -> list[list[_Line]]:
    """Return lines in groups: level or upright ones that are within a distance of one line, with planes on one side."""
    groups = list[list[_Line]]()
    for line in sorted(lines, key=lambda line: line.place):
        own = line.edge.segment
        for group in groups if own.level or own.upright else []:
            first = group[0].edge
            same = first.segment.level == own.level and first.segment.upright == own.upright
            same &= first.eaves == line.edge.eaves
            if same and first.across @ line.edge.across > 0 and line.place - group[0].place <= apart:
                group.append(line)
                break
        else:
            groups.append([line])
    return groups


def _strips(
    ends: Array, across: Array, frame: WallFrame, pixel: float, offsets: Array, options: PhotoLineOptions
) -> list[EdgeStrip]:
    """Return strips on a plane across the pieces of a line.

    Args:
        ends: of the line, drawing coordinates [2, 2].
        across: unit, towards the plane, [2].
        frame: of the plane.
        pixel: a ground pixel.
        offsets: distances from the line, ground pixels [n].
        options: length of the pieces.
    """
    span = ends[1] - ends[0]
    length = float(np.hypot(*span)) / pixel
    cut = min(0.15, options.ends / length) * span
    pieces = max(1, round(length / options.piece))
    rows = max(2, round(length / pieces / ALONG))
    share = (np.arange(pieces * rows) + 0.5) / (pieces * rows)
    along = ends[0] + cut + share[:, None] * (span - 2 * cut)
    at = along[:, None] + (offsets * pixel)[:, None] * across
    points = frame.points(at.reshape(-1, 2)).reshape(pieces, rows, len(offsets), 3)
    return [EdgeStrip(frame, piece, across) for piece in points]


def _edge_in(gradient: Array, offsets: Array, spread: float, farthest: float, contrast: float) -> float | None:
    """Return the offset of an edge in a mean gradient [n]: of its maxima the one that, times a normal distribution, is
    largest; None where none is large enough.

    Args:
        gradient: at ``offsets``.
        offsets: distances from the line, ground pixels, evenly spaced [n].
        spread: standard deviation of the distribution, around 0.
        farthest: maximum distance of the edge from 0.
        contrast: minimum gradient.
    """
    left, middle, right = gradient[:-2], gradient[1:-1], gradient[2:]
    peak = (left < middle) & (middle >= right) & (middle >= contrast)
    rows = np.flatnonzero(peak & (np.abs(offsets[1:-1]) <= farthest)) + 1
    if not len(rows):
        return None
    best = rows[(gradient[rows] * np.exp(-0.5 * (offsets[rows] / spread) ** 2)).argmax()]
    before, at, after = gradient[best - 1 : best + 2]
    return float(offsets[best] + 0.5 * STEP * (before - after) / (before - 2 * at + after))  # of the parabola


def move_lines(
    strokes: Sequence[Stroke],
    moves: Sequence[Mapping[int, Move]],
    places: dict[int, Array],
    pixel: float,
    options: StraightenOptions = StraightenOptions(),
) -> None:
    """Move segments of strokes, and the corners between them to where the lines cross now.

    Args:
        strokes: changed in place.
        moves: of the segments of each.
        places: where strokes end, number -> [2]; changed in place.
        pixel: a ground pixel.
        options: how far from its place a crossing may be.
    """
    ending: dict[int, list[Move]] = {}
    for stroke, own in zip(strokes, moves, strict=True):
        if not own:
            continue
        last, old = len(stroke.segments) - 1, stroke.points.copy()
        for k, move in own.items():
            segment = stroke.segments[k]
            stroke.segments[k] = FittedSegment(segment.at + move.vector, move.along, segment.length, known=True)
        for k in range(0 if stroke.closed else 1, last + 1):
            beside = [own[row] for row in ((k - 1) % (last + 1), k) if row in own]
            if beside and last > 0:
                meeting = [stroke.segments[k - 1], stroke.segments[k]]
                stroke.points[k] = crossing(meeting, old[k] + _together(beside), pixel, options)
        if stroke.closed:
            stroke.points[-1] = stroke.points[0]
            continue
        for end, k in ((0, 0), (-1, last)):
            if k in own:
                stroke.points[end] = stroke.segments[k].nearest(old[end])
                ending.setdefault(stroke.ends[end], []).append(own[k])
    for place, members in ending.items():
        places[place] = places[place] + _together(members)


def _together(moves: Sequence[Move]) -> Array:
    """Return the vector [2] that has, along each move, its distance, by least squares."""
    across = np.array([move.across for move in moves])
    right = across.T @ np.array([move.distance for move in moves])
    return np.asarray(np.linalg.solve(across.T @ across + _RIDGE * np.eye(2), right))
