# SPDX-License-Identifier: GPL-3.0-or-later
"""A building of the synthetic scenes whose windows and doors have arched heads."""

from __future__ import annotations

from dataclasses import replace

from benchmarks.roofs import band, hip_roof
from benchmarks.shapes import Builder, Casing, Opening, Part, wall_row


def orangery(wall: str = "brick") -> list[Part]:
    """Round arches in brick, segmental ones and level lintels in plaster above, a hip roof (13 x 8 x 10 m)."""
    b = Builder()
    x, y, storey, eaves, ridge = 6.5, 4.0, 3.8, 6.6, 9.6
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    for i, (name, length) in enumerate((("south", 13.0), ("east", 8.0), ("north", 13.0), ("west", 8.0))):
        bays = 5 if length > 10 else 3
        low = _arched(wall_row(length, bays, 1.5, 0.7, 2.6), 0.75)
        high = _arched(wall_row(length, bays, 1.15, 0.6, 1.6), 0.24)
        middle = length / 2
        if name == "south":
            low[2] = Opening(middle - 0.95, 0.0, middle + 0.95, 3.2, "door", 0.95)
        if name == "east":
            low[1] = Opening(middle - 1.2, 0.0, middle + 1.2, 2.9, "gate", 0.5)
        if name == "north":
            low, high = wall_row(length, bays, 1.2, 0.9, 1.8), _arched(high, 0.575)
        if name == "west":
            high = wall_row(length, bays, 1.0, 0.6, 1.5)
        ends = corners[i], corners[(i + 1) % 4]
        b.wall(*ends, (0, storey), wall, low, f"{name}.ground", casing=Casing(trim=wall, surround=False))
        b.wall(
            *ends,
            (storey, eaves),
            "plaster",
            high,
            name,
            casing=Casing(trim="stone" if i % 2 == 0 else "plaster", surround=i % 2 == 0),
        )
    hip_roof(b, (-x, -y), (x, y), eaves, ridge, 0.4, "tiles", "wood_trim")
    band(b, x, y, (0.0, 0.06), (storey - 0.12, storey + 0.12), "stone", "string_course")
    b.box((1.6, 0.6, 8.2), (2.3, 1.3, 10.4), "brick", "chimney")
    return b.parts()


def _arched(openings: list[Opening], rise: float) -> list[Opening]:
    """Return the openings with arched heads of that rise."""
    return [replace(opening, rise=rise) for opening in openings]
