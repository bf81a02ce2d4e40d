# SPDX-License-Identifier: GPL-3.0-or-later
"""Party walls of a row house that stands alone in its job: upright planes in which all that was seen ends.

Photos show neither a party wall nor the neighbour, who is background. The mesh then has the front and the back of the
house and its roof, and all three end in one upright plane; eaves that stand out over a wall nobody saw do not, since
the walls beside end behind them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import shapely

from mgf_engine.drawings.model import LEANING, Array, Survey
from mgf_engine.geometry.clean import open_edges
from mgf_engine.models.solid.plan_lines import Line2
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class PartyWallOptions:
    """Options of party walls that a mesh alone tells."""

    found: bool = parameter(True, "Find party walls of a building whose neighbours are not known from a map")
    reach: float = parameter(1.0, "Distance from the plane of a party wall within which the mesh ends, in details")
    beyond: float = parameter(0.02, "Largest share of the mesh beyond the plane", high=1)
    roof: float = parameter(0.8, "Smallest share of the wall's length over which the roof ends in the plane", high=1)
    sides: float = parameter(
        0.5, "Smallest share of the height over which the walls at both ends of it end in the plane", high=1
    )
    seen: float = parameter(0.2, "Largest share of the wall that the mesh shows", high=1)


@dataclass(frozen=True)
class _Rim:
    """Where a mesh ends: points on its open edges, their distance from each other, and the whole mesh."""

    at: Array
    step: float
    survey: Survey
    bottom: float
    detail: float


def find_party_walls(
    survey: Survey, walls: list[Line2], detail: float, options: PartyWallOptions = PartyWallOptions()
) -> shapely.Geometry | None:
    """Find the ground on which party walls stand; None where there are none.

    Args:
        survey: mesh in the local frame.
        walls: its walls in the ground plan; party walls are parallel or square to one of them.
        detail: what is smaller does not count.
        options: what is evidence enough.
    """
    rim = _rim(survey, detail)
    found = [line for normal in _directions(walls) for line in _in_direction(rim, normal, options)]
    return shapely.union_all([line.buffer(options.reach * detail) for line in found]) if found else None


def _rim(survey: Survey, detail: float) -> _Rim:
    """Return points on the open edges, a quarter of a detail apart."""
    start, end = (survey.mesh.vertices[rows] for rows in open_edges(survey.mesh))
    step = 0.25 * detail
    count = np.maximum(1, np.ceil(np.linalg.norm(end - start, axis=1) / step)).astype(np.int64)
    row = np.repeat(np.arange(len(count)), count)
    share = (np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[row]
    bottom = float(np.percentile(survey.mesh.vertices[:, 2], 0.5))
    return _Rim(start[row] + share[:, None] * (end - start)[row], step, survey, bottom, detail)


def _directions(walls: list[Line2]) -> Iterator[Array]:
    """Yield unit vectors [2] square to walls and along them, both ways, each once."""
    known = list[Array]()
    for line in walls:
        for normal in (line.normal, -line.normal, line.along, -line.along):
            if all(normal @ other < np.cos(np.radians(8.0)) for other in known):
                known.append(normal)
                yield normal


def _in_direction(rim: _Rim, normal: Array, options: PartyWallOptions) -> Iterator[shapely.LineString]:
    """Yield the party wall that looks in a direction, if the building ends in one."""
    survey, reach = rim.survey, options.reach * rim.detail
    away, centre = rim.at[:, :2] @ normal, survey.centres[:, :2] @ normal
    high = rim.at[:, 2] > rim.bottom + 0.5 * (survey.mesh.vertices[:, 2].max() - rim.bottom)
    along = np.array([-normal[1], normal[0]])
    length = float(np.ptp(np.percentile(survey.centres[:, :2] @ along, (1, 99))))
    plane = _outermost(away[high], 0.25 * length / rim.step, reach) if high.any() else None
    if plane is None or survey.areas[centre > plane + reach].sum() > options.beyond * survey.areas.sum():
        return
    upright = np.abs(survey.normals[:, 2]) < LEANING
    beside = upright & (np.abs(centre - plane) < 4 * rim.detail)
    if not beside.any():
        return
    low, end = np.percentile(survey.centres[beside][:, :2] @ along, (1, 99))
    inside = np.abs(away - plane) < reach
    wall = _Wall(rim.at[inside][:, :2] @ along, rim.at[inside][:, 2], float(low), float(end), rim.bottom, rim.detail)
    shown = beside & (np.abs(centre - plane) < reach) & (np.abs(survey.normals[:, :2] @ normal) > 0.9)
    if wall.is_framed(options) and survey.areas[shown].sum() < options.seen * wall.area:
        yield shapely.LineString([plane * normal + wall.low * along, plane * normal + wall.end * along])


def _outermost(away: Array, least: float, reach: float) -> float | None:
    """Return the outermost position with at least ``least`` points within half a ``reach``; None if there is none."""
    bins, ordered = np.arange(away.max(), away.min() - reach, -0.25 * reach), np.sort(away)
    count = np.searchsorted(ordered, bins + 0.5 * reach, "left") - np.searchsorted(ordered, bins - 0.5 * reach, "right")
    first = np.flatnonzero(count >= least)
    if not len(first):
        return None
    best = bins[int(first[0] + count[first[0] : first[0] + 4].argmax())]
    return float(np.median(away[np.abs(away - best) < 0.5 * reach]))


@dataclass(frozen=True)
class _Wall:
    """Where a mesh ends in an upright plane.

    Attributes:
        place, z: points of the rim that lie in the plane, along it and in height.
        low, end: extent of the walls beside it, along it.
        bottom: of the mesh.
        detail: what is smaller does not count.
    """

    place: Array
    z: Array
    low: float
    end: float
    bottom: float
    detail: float

    @property
    def top(self) -> Array:
        """Heights of the rim over the bottom, in steps of half a detail along it; 0 where there is none."""
        count = max(1, int((self.end - self.low) / (0.5 * self.detail)))
        step = np.floor((self.place - self.low) / max(self.end - self.low, 1e-9) * count).astype(np.int64)
        top, inside = np.zeros(count), (step >= 0) & (step < count)
        np.maximum.at(top, step[inside], self.z[inside] - self.bottom)
        return top

    @property
    def area(self) -> float:
        return (self.end - self.low) * float(self.top.mean())

    def is_framed(self, options: PartyWallOptions) -> bool:
        """Tell whether the roof ends in the plane from end to end, and the walls at both ends do."""
        top = self.top
        eaves = float(np.percentile(top[top > 0], 10)) if (top > 0).any() else 0.0
        if min(eaves, self.end - self.low) < 4 * self.detail or (top > 0.5 * eaves).mean() < options.roof:
            return False
        return all(self._height_share(x, eaves) >= options.sides for x in (self.low, self.end))

    def _height_share(self, place: float, height: float) -> float:
        """Return the share of a height over the bottom over which the rim goes at one end of the wall."""
        z = self.z[np.abs(self.place - place) < 1.5 * self.detail] - self.bottom
        count = max(1, int(height / (0.5 * self.detail)))
        row = np.floor(z / height * count).astype(np.int64)
        return len(np.unique(row[(row >= 0) & (row < count)])) / count
