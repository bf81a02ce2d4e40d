# SPDX-License-Identifier: GPL-3.0-or-later
"""Houses of the synthetic town, and what stands around them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.buildings import BUILDINGS
from benchmarks.roofs import gable_roof
from benchmarks.shapes import Builder, Part, wall_row
from benchmarks.surroundings import car, tree

Ring = list[tuple[float, float]]


@dataclass(frozen=True)
class House:
    """A house of the town.

    Attributes:
        id: its name in the map.
        make: makes its parts around its own origin.
        outline: its walls on the ground, in the same frame.
        place: x, y and angle of that frame in the town.
        mapped: the footprints hold it.
    """

    id: str
    make: Callable[[], list[Part]]
    outline: Ring
    place: tuple[float, float, float]
    mapped: bool = True


def row_house(wall: str, roof: str, windows: int, free: tuple[str, ...]) -> list[Part]:
    """Return a terraced house (8 x 10 x 9.4 m) whose walls towards neighbours are left out, for nobody sees them.

    Args:
        free: which of ``east`` and ``west`` have no neighbour.
    """
    b = Builder()
    x, y, eaves, ridge = 4.0, 5.0, 6.0, 9.2
    holes = [h for foot in (0.9, 3.7) for h in wall_row(2 * x, windows, 1.1, foot, 1.4)]
    b.wall((-x, -y), (x, -y), (0, eaves), wall, holes, "south")
    b.wall((x, y), (-x, y), (0, eaves), wall, holes, "north")
    if "east" in free:
        b.wall((x, -y), (x, y), (0, eaves), wall, (), "east", gable=ridge - eaves)
    if "west" in free:
        b.wall((-x, y), (-x, -y), (0, eaves), wall, (), "west", gable=ridge - eaves)
    gable_roof(b, x, y, eaves, ridge, 0.0, roof)
    b.box((-1.0, 1.0, 8.0), (-0.4, 1.6, 10.2), "brick", "chimney")
    return b.parts()


def _box(x0: float, y0: float, x1: float, y1: float) -> Ring:
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


_L_SHAPE: Ring = [(-6, -4.75), (6, -4.75), (6, -3.2), (12, -3.2), (12, 3.4), (6, 3.4), (6, 4.75), (-6, 4.75)]


HOUSES = (
    House("villa", lambda: BUILDINGS["slate_villa"]("slate"),
          [(-6, -5), (-2, -5), (-1.3, -6.3), (1.3, -6.3), (2, -5), (6, -5), (6, 5), (-6, 5)], (-25.0, 13.0, 0.0)),
    House("timber", lambda: BUILDINGS["half_timber"]("clay"), _box(-5, -4, 5, 4), (-3.0, 12.0, 0.12)),
    House("row_west", lambda: row_house("brick", "tiles", 3, ("west",)), _box(-4, -5, 4, 5), (16.0, 12.5, 0.0)),
    House("row_east", lambda: row_house("sandstone", "slate", 2, ("east",)), _box(-4, -5, 4, 5), (24.0, 12.5, 0.0)),
    House("white", lambda: BUILDINGS["plain_house"]("clean_white"), _L_SHAPE, (-20.0, -13.0, 0.0)),
    House("bungalow", lambda: BUILDINGS["bungalow"]("cladding"),
          [(-8, -3.6), (1.5, -3.6), (1.5, -8.6), (7.5, -8.6), (7.5, -3.6), (8, -3.6), (8, 3.6), (-8, 3.6)],
          (8.0, -10.5, 0.0), mapped=False),
    House("terrace_west", lambda: row_house("plaster", "tiles", 2, ("west",)), _box(-4, -5, 4, 5), (-24.0, 33.0, 0.0)),
    House("terrace_middle", lambda: row_house("brick", "slate", 3, ()), _box(-4, -5, 4, 5), (-16.0, 33.0, 0.0)),
    House("terrace_east", lambda: row_house("clay", "tiles", 2, ("east",)), _box(-4, -5, 4, 5), (-8.0, 33.0, 0.0)),
    House("red", lambda: BUILDINGS["plain_house"]("clean_red"), _L_SHAPE, (14.0, 33.5, 0.0)),
    House("chapel", lambda: BUILDINGS["chapel"]("sandstone"),
          [(-7, -4.2), (7, -4.2), (9.6, -2.2), (10, 0), (9.6, 2.2), (7, 4.2), (-7, 4.2)], (-22.0, 59.0, 0.0)),
    House("warehouse", lambda: BUILDINGS["warehouse"]("brick"), _box(-10, -5.5, 10, 5.5), (13.0, 59.5, 0.08)),
)  # fmt: skip


#: Houses -> how far their town reaches south and north, and the columns of the flight to its rows.
TOWNS = {6: (-20.0, 20.0, 1.6), 12: (-20.0, 72.0, 0.75)}


#: What the map still shows and nobody sees any more.
TORN_DOWN = _box(26, -18, 35, -10)


_STREET = 3.2  # half the width of a street


_SECOND = 46.0  # where the second one runs


def moved(points: NDArray[np.float64], place: tuple[float, float, float]) -> NDArray[np.float64]:
    """Return points [N, 2 or 3] of a house's frame in the town's."""
    x, y, angle = place
    c, s = np.cos(angle), np.sin(angle)
    turned = points.copy()
    turned[:, :2] = points[:, :2] @ np.array([[c, s], [-s, c]]) + (x, y)
    return turned


def parts_of(house: House) -> list[Part]:
    """Return the parts of a house where it stands."""
    return [replace(p, name=f"{house.id}.{p.name}", vertices=moved(p.vertices, house.place)) for p in house.make()]


def around(rng: np.random.Generator, streets: int) -> list[Part]:
    """Ground, streets, paths, trees and cars."""
    b, big = Builder(building=False, prefix="ground."), 3000.0
    b.polygon(_level(-big, -big, big, big, -0.02), "grass")
    for y in (0.0, _SECOND)[:streets]:
        b.polygon(
            [(-big, y - _STREET, 0), (big, y - _STREET, 0), (big, y + _STREET, 0), (-big, y + _STREET, 0)], "asphalt"
        )
        for side in (-1, 1):
            low, high = sorted((y + side * _STREET, y + side * (_STREET + 1.6)))
            b.polygon(_level(-60, low, 60, high, 0.03), "paving")
        for x in np.arange(-60, 60, 6.0):
            b.polygon(
                [(x, y - 0.08, 0.01), (x + 3, y - 0.08, 0.01), (x + 3, y + 0.08, 0.01), (x, y + 0.08, 0.01)], "paint"
            )
    x0, y0, x1, y1 = (*TORN_DOWN[0], *TORN_DOWN[2])
    b.polygon([(x0, y0, 0.0), (x1, y0, 0.0), (x1, y1, 0.0), (x0, y1, 0.0)], "gravel")
    parts = b.parts()
    spots = [(-13.5, 12), (6.5, 16), (33, 14), (-3, -8.5), (-36, -10), (-34, 20), (22, -22), (8, 24), (-14, 25)]
    cars = [(-30, -2.0), (-9, 2.0), (4, -2.0), (21, 2.1)]
    if streets > 1:
        spots += [(2, 36), (-34, 35), (32, 34), (-5, 58), (29, 58), (-36, 60), (-14, 69), (6, 70)]
        cars += [(-25, 44.0), (-2, 48.0), (17, 44.0)]
    for i, spot in enumerate(spots):
        parts += tree(f"tree{i}.", np.array(spot, float), float(rng.uniform(4.5, 7.5)), rng)
    for i, spot in enumerate(cars):
        parts += car(f"car{i}.", np.array(spot, float), rng)
    return parts


def _level(x0: float, y0: float, x1: float, y1: float, z: float) -> list[tuple[float, float, float]]:
    return [(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)]
