# SPDX-License-Identifier: GPL-3.0-or-later
"""Elevations and plans as line drawings with hidden lines removed: outlines, depth steps, creases and parts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from mgf_engine.drawings.foot import FootOptions, cut_at_ground
from mgf_engine.drawings.ground import GroundLevel
from mgf_engine.drawings.merge_regions import RegionMergingOptions, merge_regions
from mgf_engine.drawings.merge_segments import merge_segments
from mgf_engine.drawings.model import (
    CREASE,
    DETAIL,
    LEANING,
    OUTLINE,
    STEP,
    Array,
    DrawingFrame,
    LineDrawing,
    Polyline,
    Survey,
)
from mgf_engine.drawings.openings import ElevationOpening, ElevationPhotos, ElevationWallOptions, find_openings
from mgf_engine.drawings.overhangs import OutlineOverhangOptions, square_overhangs
from mgf_engine.drawings.photo_lines import PhotoLineOptions, find_moves, move_lines
from mgf_engine.drawings.plane_lines import PlaneLineOptions, plane_lines
from mgf_engine.drawings.project import Grid, GridBuffers, render_grid
from mgf_engine.drawings.rectangles import RectangleOptions, fit_rectangle, rectangle_stroke
from mgf_engine.drawings.regions import LOOSE, NOTHING, RegionMap, RegionOptions, find_regions
from mgf_engine.drawings.straighten import StraightenOptions, Stroke, join_ends, straighten
from mgf_engine.drawings.trace import Chain, trace
from mgf_engine.mesh.plane_detection import Planes
from mgf_engine.openings.arches import arch_outline
from mgf_engine.options.algorithms import parameter

#: Share of a loop in an opening from which it is that opening's own border.
_LOOP_WITHIN = 0.7


@dataclass(frozen=True)
class ElevationOptions:
    """Options of the lines of elevations and plans."""

    least_step: float = parameter(2.0, "Step in depth between two planes from which its edge is drawn", "ground px")
    least_angle: float = parameter(
        9.0, "Angle between two planes from which their crease is drawn", "degrees", high=180
    )
    least_loose: float = parameter(12.0, "Minimum length of a line beside a surface that is in no plane", "ground px")
    regions: RegionOptions = RegionOptions()
    merging: RegionMergingOptions = RegionMergingOptions()
    plane_lines: PlaneLineOptions = PlaneLineOptions()
    straightening: StraightenOptions = StraightenOptions()
    overhangs: OutlineOverhangOptions = OutlineOverhangOptions()
    rectangles: RectangleOptions = RectangleOptions()
    photo_lines: PhotoLineOptions = PhotoLineOptions()
    foot: FootOptions = FootOptions()
    walls: ElevationWallOptions = ElevationWallOptions()


@dataclass
class _Lines:
    """The lines of an elevation while it is drawn.

    Attributes:
        strokes: all of them; layers: of each.
        borders: the strokes that follow a border, each with that border.
        places: where strokes end, number -> [2].
        openings: left, low, right, high of what is drawn as a rectangle, [4].
    """

    strokes: list[Stroke] = field(default_factory=list)
    layers: list[str] = field(default_factory=list)
    borders: list[tuple[Stroke, Chain]] = field(default_factory=list)
    places: dict[int, Array] = field(default_factory=dict)
    openings: list[Array] = field(default_factory=list)

    def add_rectangle(self, box: Array, grid: Grid, ends: tuple[int, int], layer: str) -> None:
        """Add left, top, right, bottom in pixels of a grid [4], ending where a border did."""
        left, top, right, bottom = box
        ring = grid.places(np.array([[left, top], [right, top], [right, bottom], [left, bottom]]))
        self.strokes.append(rectangle_stroke(ring, ends))
        self.layers.append(layer)
        self.openings.append(np.concatenate([ring[3], ring[1]]))

    def add_border(self, stroke: Stroke, chain: Chain, layer: str) -> None:
        """Add the stroke of a border."""
        self.strokes.append(stroke)
        self.layers.append(layer)
        self.borders.append((stroke, chain))


def draw_elevation(
    survey: Survey,
    planes: Planes,
    frame: DrawingFrame,
    options: ElevationOptions = ElevationOptions(),
    photos: ElevationPhotos | None = None,
    ground: GroundLevel | None = None,
) -> LineDrawing:
    """Draw what a frame shows, as lines.

    Args:
        survey: mesh of the job, local frame.
        planes: of the mesh.
        frame: plane and extent of the drawing.
        options: limits of edges and creases.
        photos: to take edges of openings and of planes from; None takes them from the mesh.
        ground: around the building, where elevations end; None draws what the mesh has below it, too.
    """
    pixel = survey.working_pixel
    regions = find_regions(survey, planes, frame, options.regions)
    seen = render_grid(survey, regions.grid)
    merge_regions(regions, seen, survey, options.merging)
    found = _openings(survey, regions, seen, options, photos)
    known = plane_lines(survey, planes, frame, options.plane_lines)
    foot = cut_at_ground(regions, ground, pixel, options.foot) if ground and _is_upright(frame) else None
    if foot is not None:
        known = np.concatenate([known, foot])
    lines = _Lines()
    for opening in found:
        if not opening.rise:
            lines.add_rectangle(opening.box, regions.grid, (-1, -1), STEP)
    for chain, layer in _borders(regions, found, pixel, options):
        _draw_border(lines, chain, layer, regions, pixel, known, options)
    if photos is not None:
        moves = find_moves(lines.borders, regions, survey, photos.lines, options.photo_lines, foot)
        move_lines([stroke for stroke, _ in lines.borders], moves, lines.places, pixel, options.straightening)
    join_ends(lines.strokes, lines.places, pixel, options.straightening)
    merged = _merged(lines.strokes, lines.layers, pixel, options.straightening)
    arches = [_arched_outline(opening, regions.grid) for opening in found if opening.rise]
    boxes = [np.concatenate([line.points.min(0), line.points.max(0)]) for line in arches]
    return LineDrawing(frame, merged + arches, [], lines.openings + boxes)


def _borders(
    regions: RegionMap, openings: list[ElevationOpening], pixel: float, options: ElevationOptions
) -> Iterator[tuple[Chain, str]]:
    """Yield the borders of regions that are drawn, each with its layer: no noise in an opening.

    Args:
        regions: of the elevation.
        openings: in its walls.
        pixel: a ground pixel, local unit.
        options: from which step in depth and which angle on a border is a line.
    """
    boxes = [opening.box for opening in openings]
    slack = 0.5 * options.walls.openings.side * pixel / regions.grid.resolution
    for chain in trace(regions.label):
        layer = classify(chain, regions, pixel, options)
        if layer is not None and not is_within_opening(chain, layer, boxes, slack):
            yield chain, layer


def _draw_border(
    lines: _Lines,
    chain: Chain,
    layer: str,
    regions: RegionMap,
    pixel: float,
    known: Array,
    options: ElevationOptions,
) -> None:
    """Add a border to the lines of an elevation, as a rectangle or as straight segments.

    Args:
        lines: to add to.
        chain: the border.
        layer: its layer.
        regions: of the elevation.
        pixel: a ground pixel, local unit.
        known: lines where the planes of the mesh meet, [K, 5].
        options: of rectangles, straightening and overhangs.
    """
    corners = regions.grid.places(chain.corners)
    lines.places[chain.ends[0]], lines.places[chain.ends[1]] = corners[0], corners[-1]
    box = fit_rectangle(chain.corners, options.rectangles) if _is_opening(chain, layer) else None
    if box is not None:
        lines.add_rectangle(box, regions.grid, chain.ends, layer)
        return
    line = meeting_line(regions, chain) if layer == CREASE else known
    stroke = straighten(corners, chain.ends, pixel, line, options.straightening, frayed=True)
    if layer == OUTLINE and _is_upright(regions.grid.frame):
        square_overhangs(stroke, regions, pixel, options.overhangs)
    lines.add_border(stroke, chain, layer)


def _is_upright(frame: DrawingFrame) -> bool:
    return bool(abs(frame.normal[2]) <= LEANING)


def _openings(
    survey: Survey, regions: RegionMap, seen: GridBuffers, options: ElevationOptions, photos: ElevationPhotos | None
) -> list[ElevationOpening]:
    """Return the openings in upright walls; none seen from above."""
    if not _is_upright(regions.grid.frame):
        return []
    return find_openings(regions, seen, survey.working_pixel, options.walls, photos)


def is_within_opening(chain: Chain, kind: str, boxes: list[Array], slack: float) -> bool:
    """Tell whether a border is only the frayed border of an opening, or noise in its pane.

    It is where it lies in the opening or within ``slack`` of it. Of a closed border, which may have a spur, only most
    of the corners have to, be it the outline of a hole of the mesh; the building's own outline, which may run along the
    foot of a door, is not closed there.

    Args:
        chain: the border.
        kind: its layer.
        boxes: left, top, right, bottom of the openings, in pixels of the map [4].
        slack: in these pixels.
    """
    shares = [((chain.corners >= box[:2] - slack) & (chain.corners <= box[2:] + slack)).all(1).mean() for box in boxes]
    if kind == OUTLINE and not chain.closed:
        return False
    return max(shares, default=0.0) >= (_LOOP_WITHIN if chain.closed else 1.0)


def _arched_outline(opening: ElevationOpening, grid: Grid) -> Polyline:
    """Return the outline of an opening with an arched head as one line, closed."""
    box = grid.places(opening.box.reshape(2, 2)).ravel()
    ring = arch_outline(box, opening.rise * grid.resolution, 2 * grid.resolution)
    return Polyline(np.concatenate([ring, ring[:1]]), STEP)


def classify(
    chain: Chain, regions: RegionMap, pixel: float, options: ElevationOptions = ElevationOptions()
) -> str | None:
    """Return the layer of a border between two regions; None where there is nothing to draw.

    Args:
        chain: border between two regions.
        regions: of the elevation, with their planes.
        pixel: a ground pixel, local unit.
        options: from which step in depth and which angle on a border is a line.
    """
    if chain.low == NOTHING:
        return OUTLINE
    length = float(np.linalg.norm(np.diff(chain.corners, axis=0), axis=1).sum()) * regions.grid.resolution
    if chain.high == LOOSE:
        return DETAIL if length > options.least_loose * pixel else None
    at = regions.grid.places(chain.corners)
    step = np.median(np.abs(regions.before(chain.low, at) - regions.before(chain.high, at)))
    if step > options.least_step * pixel:
        return STEP
    turn = regions.normal(chain.low) @ regions.normal(chain.high)
    return CREASE if turn < np.cos(np.radians(options.least_angle)) else None


def _is_opening(chain: Chain, kind: str) -> bool:
    """Tell whether a border is a loop within a surface, as of a window, a door or a bay."""
    return kind in (STEP, DETAIL) and chain.ends[0] == chain.ends[1]


def meeting_line(regions: RegionMap, chain: Chain) -> Array | None:
    """Intersect the planes on both sides: the line of all its length as :func:`plane_lines` has them,
    [1, 5]; None where they are parallel."""
    line = regions.slope[chain.low - 1] - regions.slope[chain.high - 1]
    length = float(np.hypot(line[0], line[1]))
    return np.array([[*line / length, -np.inf, np.inf]]) if length > 1e-6 else None


def with_parts(drawing: LineDrawing, parts: list[Polyline]) -> LineDrawing:
    """Return the drawing with the outlines of parts; other lines inside them, which are but their frames' noise, go."""
    boxes = [(line.points.min(0), line.points.max(0)) for line in parts]
    slack = 0.1 * min((float((high - low).min()) for low, high in boxes), default=0.0)

    def outside(line: Polyline) -> bool:
        return line.layer == OUTLINE or not any(
            (line.points >= low - slack).all() and (line.points <= high + slack).all() for low, high in boxes
        )

    return LineDrawing(
        drawing.frame, [line for line in drawing.lines if outside(line)] + parts, drawing.areas, drawing.openings
    )


def _merged(strokes: list[Stroke], kinds: list[str], pixel: float, lines: StraightenOptions) -> list[Polyline]:
    """Merge the lines of each layer that are on one line."""
    result = []
    for layer in dict.fromkeys(kinds):
        segments = [
            (start, end)
            for stroke, kind in zip(strokes, kinds, strict=True)
            if kind == layer
            for start, end in pairwise(stroke.points)
        ]
        result += [Polyline(np.stack(segment), layer) for segment in merge_segments(segments, pixel, lines)]
    return result
