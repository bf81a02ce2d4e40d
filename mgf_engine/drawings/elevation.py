# SPDX-License-Identifier: GPL-3.0-or-later
"""Elevations and plans as line drawings: outlines, steps in depth, creases and parts; what is hidden is not drawn."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from mgf_engine.drawings.model import CREASE, DETAIL, OUTLINE, STEP, Array, Frame, Line, LineDrawing, Survey
from mgf_engine.drawings.regions import LOOSE, NOTHING, Regions, find_regions
from mgf_engine.drawings.straighten import Stroke, join_ends, merge, straighten
from mgf_engine.drawings.trace import Chain, trace
from mgf_engine.mesh.plane_detection import Planes

LEAST_STEP = 2.0  # working pixels between the planes on both sides, from which one hides part of the other
LEAST_TURN = np.cos(np.radians(9.0))  # of the angle between planes that meet in a crease
LEAST_LOOSE = 12.0  # working pixels; a shorter line beside something loose is noise


def draw_elevation(survey: Survey, planes: Planes, frame: Frame) -> LineDrawing:
    """What a frame shows, as lines."""
    regions = find_regions(survey, planes, frame)
    chains = trace(regions.label)
    kinds = [classify(chain, regions, survey.working_pixel) for chain in chains]
    drawn = [(chain, kind) for chain, kind in zip(chains, kinds, strict=True) if kind is not None]
    places: dict[int, Array] = {}
    strokes: list[Stroke] = []
    for chain, kind in drawn:
        corners = regions.grid.places(chain.corners)
        places[chain.ends[0]], places[chain.ends[1]] = corners[0], corners[-1]
        known = meeting_line(regions, chain) if kind == CREASE else None
        strokes.append(straighten(corners, chain.ends, survey.working_pixel, known))
    join_ends(strokes, places, survey.working_pixel)
    return LineDrawing(frame, _merged(strokes, [kind for _, kind in drawn], survey.working_pixel), [])


def classify(chain: Chain, regions: Regions, pixel: float) -> str | None:
    """The layer of a border between two regions; None where there is nothing to draw."""
    if chain.low == NOTHING:
        return OUTLINE
    length = float(np.linalg.norm(np.diff(chain.corners, axis=0), axis=1).sum()) * regions.grid.resolution
    if chain.high == LOOSE:
        return DETAIL if length > LEAST_LOOSE * pixel else None
    at = regions.grid.places(chain.corners)
    step = np.median(np.abs(regions.before(chain.low, at) - regions.before(chain.high, at)))
    if step > LEAST_STEP * pixel:
        return STEP
    turn = regions.normal(chain.low) @ regions.normal(chain.high)
    return CREASE if turn < LEAST_TURN else None


def meeting_line(regions: Regions, chain: Chain) -> Array | None:
    """The line (a, b, c) where the planes on both sides meet, (a, b) of length 1; None where they are parallel."""
    line = regions.slope[chain.low - 1] - regions.slope[chain.high - 1]
    length = float(np.hypot(line[0], line[1]))
    return line / length if length > 1e-6 else None


def with_parts(drawing: LineDrawing, parts: list[Line]) -> LineDrawing:
    """The drawing with the outlines of parts; other lines inside them, which are but their frames' noise, go."""
    boxes = [(line.points.min(0), line.points.max(0)) for line in parts]
    slack = 0.1 * min((float((high - low).min()) for low, high in boxes), default=0.0)

    def outside(line: Line) -> bool:
        return line.layer == OUTLINE or not any(
            (line.points >= low - slack).all() and (line.points <= high + slack).all() for low, high in boxes
        )

    return LineDrawing(drawing.frame, [line for line in drawing.lines if outside(line)] + parts, drawing.areas)


def _merged(strokes: list[Stroke], kinds: list[str], pixel: float) -> list[Line]:
    """Lines by layer, those on one line made into one."""
    result = []
    for layer in dict.fromkeys(kinds):
        segments = [
            (start, end)
            for stroke, kind in zip(strokes, kinds, strict=True)
            if kind == layer
            for start, end in pairwise(stroke.points)
        ]
        result += [Line(np.stack(segment), layer) for segment in merge(segments, pixel)]
    return result
