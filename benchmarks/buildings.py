# SPDX-License-Identifier: GPL-3.0-or-later
"""The building types of the synthetic scenes, as parts in metres around the origin (z up, ground at 0)."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from benchmarks.courtyards import plaster_court
from benchmarks.glass_buildings import glass_block, glass_office, glass_showroom, glass_tower
from benchmarks.houses import brick_wings, bungalow, half_timber, plain_house, slate_villa
from benchmarks.landmarks import balcony_tower, chapel, sheet_hall, warehouse
from benchmarks.orangery import orangery
from benchmarks.roofs import band, gable_roof
from benchmarks.shapes import Builder, Casing, Opening, Part, wall_row
from benchmarks.varied_buildings import factory, farm, modern_house, rotunda


def town_hall(wall: str = "brick") -> list[Part]:
    """A gabled brick hall with a projecting bay, dormers, chimneys and a small clock turret (24 x 12 x 15 m)."""
    b = Builder()
    length, width, eaves, ridge = 24.0, 12.0, 8.4, 14.2
    x, y = length / 2, width / 2
    floors = [(1.1, 1.9), (4.7, 2.0)]
    long_holes = [hole for foot, height in floors for hole in wall_row(length, 9, 1.2, foot, height)]
    south = [hole for hole in long_holes if not 8.2 < (hole.u0 + hole.u1) / 2 < 15.8]
    gable_holes = [hole for foot, height in floors for hole in wall_row(width, 4, 1.2, foot, height)]
    for name, a, c, holes, gable in (
        ("south", (-x, -y), (x, -y), south, 0.0),
        ("east", (x, -y), (x, y), gable_holes, ridge - eaves),
        ("north", (x, y), (-x, y), long_holes, 0.0),
        ("west", (-x, y), (-x, -y), gable_holes, ridge - eaves),
    ):
        b.wall(a, c, (0, eaves), wall, holes, name, gable=gable)
    gable_roof(b, x, y, eaves, ridge, 0.45)
    _bay(b, wall, y)
    for px in (-7.0, 5.5):
        b.box((px, 1.6, 11.4), (px + 0.9, 2.5, 15.6), wall, "chimneys")
        b.box((px - 0.08, 1.52, 15.6), (px + 0.98, 2.58, 15.8), "stone", "chimneys")
    for i, px in enumerate((-8.0, 8.0)):
        _dormer(b, px, y, i)
    _turret(b, ridge)
    for sx, sy in ((-x, -y), (x, -y), (x, y), (-x, y)):
        b.box((sx - 0.06, sy - 0.06, 0), (sx + 0.06, sy + 0.06, eaves), "stone", "quoins")
    band(b, x, y, (0.0, 0.08), (0.0, 0.7), "stone", "plinth")
    band(b, x, y, (0.0, 0.06), (3.7, 3.95), "stone", "string_course")
    return b.parts()


def _bay(b: Builder, wall: str, y: float) -> None:
    """The projecting middle of the south front, with its own gable, the door and steps."""
    half, out, eaves, ridge = 3.6, 1.6, 8.4, 12.4
    front = [
        *wall_row(2 * half, 3, 1.3, 4.7, 2.2),
        Opening(half - 0.95, 0.75, half + 0.95, 3.5, "door"),
        Opening(0.5, 1.1, 1.6, 3.0),
        Opening(2 * half - 1.6, 1.1, 2 * half - 0.5, 3.0),
    ]
    f = -y - out
    b.wall((-half, f), (half, f), (0, eaves), wall, front, "bay", gable=ridge - eaves)
    b.wall((half, f), (half, -y), (0, eaves), wall, (), "bay.east")
    b.wall((-half, -y), (-half, f), (0, eaves), wall, (), "bay.west")
    over, back = 0.35, -1.2
    slope = (ridge - eaves) / half
    low = eaves - slope * over + 0.2
    for side in (1, -1):
        edge = side * (half + over)
        quad = [(edge, f - over, low), (edge, back, low), (0, back, ridge + 0.2), (0, f - over, ridge + 0.2)]
        b.roof_slab(quad if side > 0 else quad[::-1], 0.2, "tiles", "wood_trim", "roof.bay")
    for i in range(4):
        b.box((-1.9, f - 0.3 * (4 - i), 0), (1.9, f - 0.3 * (3 - i), 0.18 * (i + 1)), "stone", "steps")
    disc = [(0.75 * np.cos(t), f - 0.07, 9.7 + 0.75 * np.sin(t)) for t in np.linspace(0, 2 * np.pi, 25)[:-1]]
    b.polygon(disc, "stone", "rosette")
    for i in range(24):
        j = (i + 1) % 24
        b.polygon([disc[j], disc[i], (disc[i][0], f, disc[i][2]), (disc[j][0], f, disc[j][2])], "stone", "rosette")


def _dormer(b: Builder, centre: float, y: float, number: int) -> None:
    half, foot, top, front = 1.0, 9.6, 11.1, -y + 1.0
    hole = [Opening(0.35, 0.35, 1.65, 1.4)]
    ends = (centre - half, front), (centre + half, front)
    b.wall(*ends, (foot, top), "plaster", hole, f"dormer{number}", gable=0.9, casing=Casing(trim="wood_trim"))
    back = -2.4
    b.wall((centre + half, front), (centre + half, back), (foot, top), "slate", (), f"dormer{number}")
    b.wall((centre - half, back), (centre - half, front), (foot, top), "slate", (), f"dormer{number}")
    o = 0.2
    for s in (1, -1):
        quad = [(centre + s * (half + o), front - o, top - 0.1), (centre + s * (half + o), back, top - 0.1),
                (centre, back + 1.2, top + 1.0), (centre, front - o, top + 1.0)]  # fmt: skip
        b.roof_slab(quad if s > 0 else quad[::-1], 0.12, "tiles", "wood_trim", f"dormer{number}")


def _turret(b: Builder, ridge: float) -> None:
    half, foot, top = 1.1, ridge - 1.2, ridge + 2.2
    corners = [(-half, -half), (half, -half), (half, half), (-half, half)]
    hole, casing = [Opening(0.6, 1.7, 1.6, 3.0)], Casing(trim="wood_trim")
    for i in range(4):
        b.wall(corners[i], corners[(i + 1) % 4], (foot, top), "plaster", hole, "turret", casing=casing)
    edge, apex = half + 0.3, (0.0, 0.0, top + 2.6)
    eave = [(-edge, -edge, top), (edge, -edge, top), (edge, edge, top), (-edge, edge, top)]
    for i in range(4):
        b.polygon([eave[i], eave[(i + 1) % 4], apex], "copper", "turret.roof")
    b.polygon(eave[::-1], "wood_trim", "turret.roof")


def flat_block(wall: str = "plaster") -> list[Part]:
    """A long flat-roofed block with regular windows, a parapet and roof equipment (36 x 11 x 13 m)."""
    b = Builder()
    x, y, height = 18.0, 5.5, 13.0
    long_holes = [h for f in range(4) for h in wall_row(36, 14, 1.5, 1.0 + 3.1 * f, 1.6)]
    short = [h for f in range(4) for h in wall_row(11, 3, 1.4, 1.0 + 3.1 * f, 1.6)]
    front = [h for h in long_holes if not (h.v0 < 2 and 16.5 < (h.u0 + h.u1) / 2 < 19.5)]
    front.append(Opening(16.9, 0.0, 19.1, 2.6, "door"))
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    for i, (name, holes) in enumerate((("south", front), ("east", short), ("north", long_holes), ("west", short))):
        b.wall(corners[i], corners[(i + 1) % 4], (0, height), wall, holes, name)
    b.polygon(
        [(-x, -y, height - 0.6), (x, -y, height - 0.6), (x, y, height - 0.6), (-x, y, height - 0.6)], "gravel", "roof"
    )
    band(b, x, y, (-0.3, 0.0), (height - 0.6, height + 0.1), "concrete", "parapet")
    for px, sx, sy, sz in ((-11, 3.0, 2.2, 1.9), (2, 4.5, 3.0, 2.6), (11.5, 1.6, 1.6, 1.3)):
        b.box((px, -sy / 2, height - 0.6), (px + sx, sy / 2, height - 0.6 + sz), "metal", "equipment")
    b.box((-1.8, -y - 1.7, 2.8), (1.8, -y, 3.05), "concrete", "canopy")
    for px in (-1.6, 1.5):
        b.box((px, -y - 1.6, 0), (px + 0.14, -y - 1.46, 2.8), "metal", "canopy")
    return b.parts()


def tower(wall: str = "brick") -> list[Part]:
    """A square brick tower with louvres, a stone gallery and a pointed roof (7 x 7 x 34 m)."""
    b = Builder()
    half, height = 3.5, 24.0
    corners = [(-half, -half), (half, -half), (half, half), (-half, half)]
    for i, name in enumerate(("south", "east", "north", "west")):
        holes = [Opening(2.9, 4 + 4.6 * k, 4.1, 6.2 + 4.6 * k) for k in range(3)]
        holes += [Opening(1.2, 18.4, 2.8, 22.2), Opening(4.2, 18.4, 5.8, 22.2)]
        if i == 0:
            holes.append(Opening(2.5, 0.2, 4.5, 3.0, "door"))
        b.wall(corners[i], corners[(i + 1) % 4], (0, height), wall, holes, name)
    for level, out, thick in ((8.2, 0.12, 0.3), (17.4, 0.16, 0.35), (24.0, 0.45, 0.4)):
        b.box((-half - out, -half - out, level), (half + out, half + out, level + thick), "stone", "courses")
    e, apex = half + 0.2, (0.0, 0.0, 34.0)
    eave = [(-e, -e, 24.4), (e, -e, 24.4), (e, e, 24.4), (-e, e, 24.4)]
    for i in range(4):
        b.polygon([eave[i], eave[(i + 1) % 4], apex], "slate", "roof")
    b.box((-0.08, -0.08, 33.6), (0.08, 0.08, 36.0), "metal", "roof")
    return b.parts()


def steel_frame(wall: str = "brick") -> list[Part]:
    """A brick machine hall beside an open steel winding frame: bars, cross bracing, platforms."""
    b = Builder()
    x, y, eaves, ridge = 9.0, 5.0, 6.5, 9.6
    holes = wall_row(2 * x, 6, 1.5, 1.2, 3.6)
    corners = [(-x - 6, -y), (x - 6, -y), (x - 6, y), (-x - 6, y)]
    for i, (name, h) in enumerate(
        (("south", holes), ("east", []), ("north", holes), ("west", wall_row(2 * y, 3, 1.4, 1.2, 3.4)))
    ):
        b.wall(corners[i], corners[(i + 1) % 4], (0, eaves), wall, h, name, gable=(ridge - eaves) if i % 2 else 0.0)
    o = 0.35
    low = eaves - (ridge - eaves) / y * o + 0.18
    for s in (-1, 1):
        quad = [
            (-x - 6 - o, s * (y + o), low),
            (x - 6 + o, s * (y + o), low),
            (x - 6 + o, 0, ridge + 0.18),
            (-x - 6 - o, 0, ridge + 0.18),
        ]
        b.roof_slab(quad if s < 0 else quad[::-1], 0.18, "tiles", "wood_trim", "roof")
    _winding_frame(b, 9.5, 20.0)
    return b.parts()


def _winding_frame(b: Builder, centre: float, height: float) -> None:
    def leg(sx: int, sy: int, z: float) -> tuple[float, float, float]:
        spread = 3.2 - 1.5 * z / height
        return centre + sx * spread, sy * spread, z

    levels = np.linspace(0, height, 6)
    ring = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    for s in ring:
        b.beam(leg(*s, 0), leg(*s, height), 0.34, "steel", "frame.legs")
    for low, high in pairwise(levels):
        for i in range(4):
            a, c = ring[i], ring[(i + 1) % 4]
            b.beam(leg(*a, high), leg(*c, high), 0.22, "steel", "frame.rings")
            b.beam(leg(*a, low), leg(*c, high), 0.16, "steel", "frame.braces")
            b.beam(leg(*c, low), leg(*a, high), 0.16, "steel", "frame.braces")
    for z in (levels[3], levels[5]):
        h = 3.2 - 1.5 * z / height + 0.6
        b.box((centre - h, -h, z), (centre + h, h, z + 0.12), "metal", "frame.platforms")
        for i in range(4):
            a, c = ring[i], ring[(i + 1) % 4]
            b.beam(
                (centre + a[0] * h, a[1] * h, z + 1.1),
                (centre + c[0] * h, c[1] * h, z + 1.1),
                0.07,
                "steel",
                "frame.rails",
            )
            b.beam(
                (centre + a[0] * h, a[1] * h, z), (centre + a[0] * h, a[1] * h, z + 1.1), 0.07, "steel", "frame.rails"
            )
    for side in (-1.0, 1.0):
        _wheel(b, (centre, side * 0.8, height + 1.7), 1.6)
        b.beam((centre - 9.5, side * 1.4, 0.2), (centre - 1.2, side * 1.2, height), 0.34, "steel", "frame.struts")


def _wheel(b: Builder, centre: tuple[float, float, float], radius: float) -> None:
    angles = np.linspace(0, 2 * np.pi, 17)
    rim = [(centre[0] + radius * np.cos(t), centre[1], centre[2] + radius * np.sin(t)) for t in angles]
    for a, c in pairwise(rim):
        b.beam(a, c, 0.16, "steel", "frame.wheels")
    for end in rim[:-1:2]:
        b.beam(centre, end, 0.09, "steel", "frame.wheels")


def curved_hall(wall: str = "plaster") -> list[Part]:
    """A hall under a barrel roof of metal sheets with glazed ends (26 x 16 x 11 m)."""
    b = Builder()
    x, y, spring, rise = 13.0, 8.0, 4.0, 7.0
    holes = wall_row(2 * x, 8, 2.0, 1.2, 1.9)
    b.wall((-x, -y), (x, -y), (0, spring), wall, holes, "south")
    b.wall((x, y), (-x, y), (0, spring), wall, holes, "north")
    angles = np.linspace(0, np.pi, 25)
    arc = np.stack([-y * np.cos(angles), spring + rise * np.sin(angles)], axis=1)
    over = 0.5
    for (y0, z0), (y1, z1) in pairwise(arc):
        b.roof_slab(
            [(-x - over, y0, z0), (x + over, y0, z0), (x + over, y1, z1), (-x - over, y1, z1)],
            0.15,
            "sheet",
            "metal",
            "roof",
        )
    for name, sx in (("east", 1), ("west", -1)):
        ends = ((sx * x, -sx * y), (sx * x, sx * y))
        door = [Opening(6.4, 0.0, 9.6, 3.4, "gate"), *(Opening(u, 1.0, u + 2.0, 3.2) for u in (1.2, 3.8, 10.2, 12.8))]
        b.wall(*ends, (0, spring), wall, door, name)
        for (y0, z0), (y1, z1) in pairwise(arc):
            fan = [(sx * x, -y0, spring), (sx * x, -y1, spring), (sx * x, -y1, z1), (sx * x, -y0, z0)]
            b.polygon(fan if sx < 0 else fan[::-1], "brick" if wall != "brick" else "plaster", f"{name}.tympanum")
        for py in (-4.0, 0.0, 4.0):
            top = spring + rise * np.sqrt(1 - (py / y) ** 2) - 0.3
            b.beam((sx * (x + 0.05), py, spring), (sx * (x + 0.05), py, top), 0.25, "metal", f"{name}.posts")
    return b.parts()


#: Elements of open steelwork begin so; the paper leaves such out of its figures (section 4.3.1).
STEELWORK = "frame."

BUILDINGS: dict[str, Callable[[str], list[Part]]] = {
    "town_hall": town_hall,
    "flat_block": flat_block,
    "tower": tower,
    "steel_frame": steel_frame,
    "curved_hall": curved_hall,
    "plain_house": plain_house,
    "half_timber": half_timber,
    "slate_villa": slate_villa,
    "bungalow": bungalow,
    "brick_wings": brick_wings,
    "warehouse": warehouse,
    "sheet_hall": sheet_hall,
    "glass_office": glass_office,
    "glass_showroom": glass_showroom,
    "glass_block": glass_block,
    "glass_tower": glass_tower,
    "balcony_tower": balcony_tower,
    "chapel": chapel,
    "plaster_court": plaster_court,
    "orangery": orangery,
    "factory": factory,
    "rotunda": rotunda,
    "modern_house": modern_house,
    "farm": farm,
}
