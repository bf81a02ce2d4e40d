# SPDX-License-Identifier: GPL-3.0-or-later
"""A building around a court, photographed from within: only what can be seen from the court is built."""

from __future__ import annotations

from itertools import pairwise

from benchmarks.roofs import Corner, cone, drum, ring_points
from benchmarks.shapes import Builder, Casing, Opening, Part, wall_row

#: Half sizes of the court, metres.
_X, _Y = 12.0, 9.0


def plaster_court(wall: str = "plaster") -> list[Part]:
    """Three wings of plaster around a court, a low wall with a gate, a stair turret (24 x 18 m inside, 12 m high)."""
    b = Builder()
    trim = Casing(depth=0.22, trim="sandstone")
    north = [*wall_row(24.0, 6, 1.3, 4.6, 2.2), *wall_row(24.0, 6, 1.3, 1.2, 1.9)]
    north[8] = Opening(10.7, 0.0, 13.3, 3.4, "door")
    del north[9]
    sides = [*wall_row(18.0, 4, 1.2, 4.4, 1.8), *wall_row(18.0, 4, 1.2, 1.1, 1.7)]
    b.wall((-_X, _Y), (_X, _Y), (0, 9.0), wall, north, "north", casing=trim)
    b.wall((_X, _Y), (_X, -_Y), (0, 7.2), wall, sides, "east", casing=trim)
    b.wall((-_X, -_Y), (-_X, _Y), (0, 7.2), wall, sides[:4], "west", casing=trim)
    _arcade(b, wall)
    _slope(b, ((-_X - 3.5, _Y), (_X + 3.5, _Y)), (9.0, 12.4), (0.0, 1.0))
    _slope(b, ((_X, _Y), (_X, -_Y)), (7.2, 10.0), (1.0, 0.0))
    _slope(b, ((-_X, -_Y), (-_X, _Y)), (7.2, 10.0), (-1.0, 0.0))
    gate = [Opening(10.4, 0.0, 13.6, 2.9, "void")]
    b.wall((_X, -_Y), (-_X, -_Y), (0, 3.3), wall, gate, "south", casing=Casing(depth=0.6, trim="sandstone"))
    b.box((-_X, -_Y - 0.65, 3.3), (_X, -_Y + 0.05, 3.42), "tiles", "south")
    for z in (3.75, 8.75):
        b.box((-_X, _Y - 0.12, z), (_X, _Y, z + 0.2), "sandstone", "bands")
    _turret(b, wall, (_X - 1.0, _Y - 1.0))
    return b.parts()


def _arcade(b: Builder, wall: str) -> None:
    """A row of pillars under a lean-to roof before the west wing."""
    front, top = -_X + 2.6, 3.3
    for i in range(7):
        y = -_Y + 1.0 + i * 2.6
        b.box((front - 0.25, y - 0.25, 0.0), (front + 0.25, y + 0.25, top - 0.5), "sandstone", "arcade")
    b.box((front - 0.3, -_Y + 0.5, top - 0.5), (front + 0.3, _Y - 1.0, top), wall, "arcade")
    quad = [(front + 0.5, -_Y + 0.4, top), (front + 0.5, _Y, top), (-_X, _Y, top + 0.9), (-_X, -_Y + 0.4, top + 0.9)]
    b.roof_slab(quad, 0.12, "tiles", "wood_trim", "roof.arcade")


def _slope(b: Builder, ends: tuple[Corner, Corner], heights: tuple[float, float], back: Corner) -> None:
    """The slope that faces the court, over a wall from left to right; ``back`` points away from the court."""
    (x0, y0), (x1, y1) = ends
    (eaves, ridge), run, over = heights, 3.5, 0.45
    low = eaves - (ridge - eaves) / run * over + 0.2

    def at(x: float, y: float, off: float, z: float) -> tuple[float, float, float]:
        return x + back[0] * off, y + back[1] * off, z

    quad = [at(x0, y0, -over, low), at(x1, y1, -over, low), at(x1, y1, run, ridge), at(x0, y0, run, ridge)]
    b.roof_slab(quad, 0.2, "tiles", "wood_trim", "roof")
    b.beam(at(x0, y0, -over, low - 0.1), at(x1, y1, -over, low - 0.1), 0.14, "metal", "gutter")
    b.beam(at(x0, y0, run, ridge + 0.02), at(x1, y1, run, ridge + 0.02), 0.22, "ridge_tiles", "roof.ridge")


def _turret(b: Builder, wall: str, centre: Corner) -> None:
    """A round stair turret in a corner of the court, with small windows' surrounds and a pointed roof."""
    arc = ring_points(centre, 2.1, 0.0, 360.0, 28)
    drum(b, arc, 0.0, 11.2, wall, "turret")
    for z in (3.7, 7.4, 11.0):
        for (x0, y0), (x1, y1) in pairwise(ring_points(centre, 2.18, 0.0, 360.0, 28)):
            b.beam((x0, y0, z), (x1, y1, z), 0.18, "sandstone", "turret")
    cone(b, ring_points(centre, 2.5, 0.0, 360.0, 28), 11.2, (*centre, 15.2), "slate", "wood_trim", "roof.turret")
