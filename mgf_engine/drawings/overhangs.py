# SPDX-License-Identifier: GPL-3.0-or-later
"""Overhangs in the outline of an elevation: level undersides, where the mesh goes slantwise from eaves to wall.

Photos from above do not show the underside of eaves, so the mesh fills the corner below them. In the outline that is a
short slanted line from the eaves down and inwards to an upright one, drawn as the level and the upright line of the
corner that it cuts off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mgf_engine.drawings.model import Array
from mgf_engine.drawings.regions import NOTHING, RegionMap
from mgf_engine.drawings.straighten import FittedSegment, Stroke
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class OutlineOverhangOptions:
    """Options of the undersides of overhangs in outlines."""

    longest: float = parameter(
        24.0, "Maximum length of a slanted line below an overhang; 0 draws all as the mesh has them", "ground px"
    )
    least: float = parameter(2.0, "Minimum length of that line sideways", "ground px")


def square_overhangs(
    stroke: Stroke, regions: RegionMap, pixel: float, options: OutlineOverhangOptions = OutlineOverhangOptions()
) -> None:
    """Draw short slanted lines below overhangs as a level and an upright one.

    Args:
        stroke: part of an outline, changed in place.
        regions: of the elevation.
        pixel: a ground pixel, local unit.
        options: lengths of the lines.
    """
    for k, segment in enumerate(stroke.segments):
        for beside in (k - 1, k + 1):
            if not 0 <= beside < len(stroke.segments) or not stroke.segments[beside].upright:
                continue
            if segment.upright or segment.level or segment.length > options.longest * pixel:
                continue
            inner, outer = (k, k + 1) if beside < k else (k + 1, k)
            wall, edge = stroke.points[inner], stroke.points[outer]
            away = float(abs(edge[0] - wall[0]))
            if edge[1] > wall[1] and away > options.least * pixel and _is_inside(regions, wall, edge):
                corner = np.array([wall[0], edge[1]])
                along = np.array([np.sign(stroke.points[k + 1, 0] - stroke.points[k, 0]), 0.0])
                stroke.segments[k] = FittedSegment(0.5 * (corner + edge), along, away, True)
                stroke.points[inner] = corner
                break


def _is_inside(regions: RegionMap, wall: Array, edge: Array) -> bool:
    """Tell whether the building covers the middle of the triangle below an overhang."""
    middle = (wall + edge + np.array([wall[0], edge[1]])) / 3
    return bool(regions.grid.look_up(regions.label, middle[None], NOTHING)[0] != NOTHING)
