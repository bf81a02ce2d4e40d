# SPDX-License-Identifier: GPL-3.0-or-later
"""The plane that a line of a drawing is the edge of: the nearer one, or the roof whose eaves it is.

Photos from above do not show undersides, so that a mesh may have no overhang: it goes from the wall straight into the
roof. The eaves then lie farther down on the roof's plane than where the two meet, and level in an elevation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mgf_engine.drawings.model import LEANING, Array
from mgf_engine.drawings.regions import LOOSE, NOTHING, RegionMap
from mgf_engine.drawings.straighten import FittedSegment
from mgf_engine.drawings.trace import Chain

_BESIDE = (2.0, 4.0, 6.0)  # ground pixels beside a line at which its plane is looked for
_PLACES = 40  # along it
_CLEAR = 0.17  # share of these by which its plane has to lie rather on one side
_STEEP = float(np.cos(np.radians(53.0)))  # of what is below eaves: a wall, or the steep part of a mansard roof
_LEVEL = float(np.cos(np.radians(10.0)))  # largest angle between eaves and a level line on their roof


class EdgeOfPlane(NamedTuple):
    """A line as the edge of a plane, drawing coordinates.

    Attributes:
        label: of the plane's region.
        across: unit vector across the line towards the region, [2].
        segment: the line.
        ends: of the line, [2, 2].
        eaves: whether it is the lower edge of a roof.
    """

    label: int
    across: Array
    segment: FittedSegment
    ends: Array
    eaves: bool


def edge_of_plane(
    segment: FittedSegment, ends: Array, chain: Chain, regions: RegionMap, pixel: float, roof: tuple[float, float]
) -> EdgeOfPlane | None:
    """Return the plane that a line is the edge of; None where it is loose, or unclear on which side it lies.

    Args:
        segment: the line.
        ends: of the line, [2, 2].
        chain: the border that it is of.
        regions: of the drawing.
        pixel: a ground pixel.
        roof: least and largest slope of a roof, degrees.
    """
    labels = [label for label in (chain.low, chain.high) if label not in (NOTHING, LOOSE)]
    for label in labels:
        across = _side(label, ends, regions, pixel)
        if across is not None and _is_eaves(label, labels, across, regions, roof):
            if abs(regions.grid.frame.normal[2]) <= LEANING:  # from above, the border says better how they are turned
                segment = _levelled(segment)
                ends = np.array([segment.nearest(end) for end in ends])
            return EdgeOfPlane(label, across, segment, ends, True)
    nearest = max(labels, key=lambda label: float(regions.before(label, ends.mean(0)[None])[0]), default=None)
    across = None if nearest is None else _side(nearest, ends, regions, pixel)
    return None if nearest is None or across is None else EdgeOfPlane(nearest, across, segment, ends, False)


def _is_eaves(label: int, labels: list[int], across: Array, regions: RegionMap, roof: tuple[float, float]) -> bool:
    """Tell whether a line is the lower edge of the roof that lies ``across`` [2] it, with nothing or a wall below."""
    frame = regions.grid.frame
    up = np.array([frame.x[2], frame.y[2], frame.normal[2]])
    rises = {other: float(regions.normal(other) @ up) for other in labels}
    flattest, steepest = np.cos(np.radians(roof))
    if not steepest < rises[label] < flattest:
        return False
    if any(abs(rise) > _STEEP for other, rise in rises.items() if other != label):
        return False
    return bool(across @ _uphill(label, regions) > _LEVEL)


def _uphill(label: int, regions: RegionMap) -> Array:
    """Return the unit vector [2] in which a plane rises most, drawing coordinates."""
    frame = regions.grid.frame
    up = np.array([frame.x[2], frame.y[2]]) + frame.normal[2] * regions.slope[label - 1, :2]
    return np.asarray(up / np.hypot(*up))


def _levelled(segment: FittedSegment) -> FittedSegment:
    """Return the segment turned about its middle so that it is level."""
    along = np.array([np.sign(segment.along[0]) or 1.0, 0.0])
    return FittedSegment(segment.at, along, segment.length, segment.known)


def _side(label: int, ends: Array, regions: RegionMap, pixel: float) -> Array | None:
    """Return the unit vector [2] across a line [2, 2] to the side where a region lies; None if that is unclear."""
    span = ends[1] - ends[0]
    across = np.array([-span[1], span[0]]) / max(float(np.hypot(*span)), 1e-300)
    along = ends[0] + (np.arange(_PLACES)[:, None] + 0.5) / _PLACES * span
    shares = []
    for sign in (1.0, -1.0):
        at = np.concatenate([along + sign * beside * pixel * across for beside in _BESIDE])
        shares.append((regions.grid.look_up(regions.label, at, NOTHING) == label).mean())
    if abs(shares[0] - shares[1]) < _CLEAR:
        return None
    return across if shares[0] > shares[1] else -across
