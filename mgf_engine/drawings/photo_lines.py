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

from mgf_engine.drawings.model import Array, Survey
from mgf_engine.drawings.regions import LOOSE, NOTHING, RegionMap
from mgf_engine.drawings.straighten import FittedSegment, StraightenOptions, Stroke, crossing
from mgf_engine.drawings.trace import Chain
from mgf_engine.geometry.normals import unit_vectors
from mgf_engine.geometry.rasterize import render_mesh
from mgf_engine.model.masks import building
from mgf_engine.openings.photo_edges import ALONG, STEP, EdgePhotos, EdgeStrip, mean_gradients
from mgf_engine.openings.wall_frame import WallFrame
from mgf_engine.options.algorithms import parameter
from mgf_engine.texture.painting import Painting

_BESIDE = (2.0, 4.0, 6.0)  # ground pixels beside a line at which its plane is looked for
_PLACES = 40  # along it
_CLEAR = 0.17  # share of these by which its plane has to lie rather on one side
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
    """How far a line moves: ``distance`` along the unit vector ``across`` [2], drawing coordinates."""

    across: Array
    distance: float

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
        fitted: the segment.
        across: unit vector towards its plane, [2].
        pieces: numbers of its strips.
    """

    stroke: int
    segment: int
    fitted: FittedSegment
    across: Array
    pieces: range


def find_moves(
    lines: Sequence[tuple[Stroke, Chain]],
    regions: RegionMap,
    survey: Survey,
    photos: EdgePhotos,
    options: PhotoLineOptions = PhotoLineOptions(),
) -> list[dict[int, Move]]:
    """Find how far the segments of strokes lie from the edges of planes in the photos.

    Args:
        lines: strokes, and the borders that they are of.
        regions: of the drawing.
        survey: converts to the normalised frame.
        photos: to look at.
        options: limits.

    Returns:
        For each stroke the moves of those segments that an edge was found for; level or upright ones on one line move
        together.
    """
    pixel = survey.working_pixel
    offsets = np.arange(-options.reach, options.reach + 0.5 * STEP, STEP)
    found, strips = list[_Line](), list[EdgeStrip]()
    for row, (stroke, chain) in enumerate(lines):
        for k, segment in enumerate(stroke.segments):
            ends = stroke.points[k : k + 2]
            label = _nearer_plane(chain, ends.mean(0), regions)
            across = None if label is None else _towards(label, ends, regions, pixel)
            if label is None or across is None or np.hypot(*(ends[1] - ends[0])) < options.least * pixel:
                continue
            pieces = _strips(ends, across, plane_frame(regions, label, survey), pixel, offsets, options)
            found.append(_Line(row, k, segment, across, range(len(strips), len(strips) + len(pieces))))
            strips += pieces
    curves = mean_gradients(strips, photos, options)
    moves: list[dict[int, Move]] = [{} for _ in lines]
    for group in _on_one_line(found, options.same_line * pixel):
        rows = [piece for line in group for piece in line.pieces]
        known = curves[rows][np.isfinite(curves[rows, 0])]
        if len(known) < options.shown * len(rows):
            continue
        distance = _edge_in(known.mean(0), offsets, any(line.fitted.known for line in group), options)
        if distance is not None:
            place = np.average([line.fitted.at @ line.across for line in group], weights=[len(x.pieces) for x in group])
            for line in group:
                off = float(place - line.fitted.at @ line.across) if len(group) > 1 else 0.0
                moves[line.stroke][line.segment] = Move(line.across, distance * pixel + off)
    return moves


def _on_one_line(lines: Sequence[_Line], apart: float) -> list[list[_Line]]:
    """Return lines in groups: level or upright ones that are within a distance of one line, with planes on one side."""
    groups = list[list[_Line]]()
    ordered = sorted(lines, key=lambda line: float(line.fitted.at @ line.across))
    for line in ordered:
        alone = not (line.fitted.level or line.fitted.upright)
        place = float(line.fitted.at @ line.across)
        for group in [] if alone else groups:
            first = group[0]
            same = first.fitted.level == line.fitted.level and first.fitted.upright == line.fitted.upright
            if same and first.across @ line.across > 0 and place - float(first.fitted.at @ first.across) <= apart:
                group.append(line)
                break
        else:
            groups.append([line])
    return groups


def _nearer_plane(chain: Chain, at: Array, regions: RegionMap) -> int | None:
    """Return the label of the plane on the nearer side of a border at a point [2]; None where it is loose."""
    labels = [label for label in (chain.low, chain.high) if label not in (NOTHING, LOOSE)]
    return max(labels, key=lambda label: float(regions.before(label, at[None])[0]), default=None)


def _towards(label: int, ends: Array, regions: RegionMap, pixel: float) -> Array | None:
    """Return the unit vector [2] across a line [2, 2] to the side where a region lies; None if that is unclear."""
    span = ends[1] - ends[0]
    across = np.array([-span[1], span[0]]) / max(float(np.hypot(*span)), 1e-300)
    along = ends[0] + (np.arange(_PLACES)[:, None] + 0.5) / _PLACES * span
    shares = []
    for sign in (1.0, -1.0):
        at = np.concatenate([along + sign * beside * pixel * across for beside in _BESIDE])
        column, row = np.floor(regions.grid.pixels(at)).astype(np.int64).T
        inside = (row >= 0) & (row < regions.grid.height) & (column >= 0) & (column < regions.grid.width)
        shares.append((regions.label[row[inside], column[inside]] == label).sum() / len(at))
    if abs(shares[0] - shares[1]) < _CLEAR:
        return None
    return across if shares[0] > shares[1] else -across


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


def _edge_in(gradient: Array, offsets: Array, known: bool, options: PhotoLineOptions) -> float | None:
    """Return the offset of an edge in a mean gradient [n]: of its maxima the one that, times a normal distribution, is
    largest; None where none is large enough.

    Args:
        gradient: at ``offsets``.
        offsets: distances from the line, ground pixels, evenly spaced [n].
        known: whether planes of the mesh give the line.
        options: the distribution, and how large a gradient has to be.
    """
    spread, farthest = (options.spread_known, options.farthest_known) if known else (options.spread, options.farthest)
    left, middle, right = gradient[:-2], gradient[1:-1], gradient[2:]
    peak = (left < middle) & (middle >= right) & (middle >= options.contrast)
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
            stroke.segments[k] = FittedSegment(segment.at + move.vector, segment.along, segment.length, known=True)
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
                stroke.points[end] = old[end] + own[k].vector
                ending.setdefault(stroke.ends[end], []).append(own[k])
    for place, members in ending.items():
        places[place] = places[place] + _together(members)


def _together(moves: Sequence[Move]) -> Array:
    """Return the vector [2] that has, along each move, its distance, by least squares."""
    across = np.array([move.across for move in moves])
    right = across.T @ np.array([move.distance for move in moves])
    return np.asarray(np.linalg.solve(across.T @ across + _RIDGE * np.eye(2), right))
