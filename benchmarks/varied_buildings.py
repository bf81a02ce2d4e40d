# SPDX-License-Identifier: GPL-3.0-or-later
"""Buildings of the synthetic scenes that mix materials and shapes: a factory, a rotunda, a modern house, a farm."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from benchmarks.roofs import Corner, band, cone, drum, ring_points
from benchmarks.shapes import Builder, Casing, Opening, Part, WallFrame, wall_row

_PLAIN = Casing(trim="metal", surround=False)


def factory(wall: str = "shiny_sheet") -> list[Part]:
    """Sawtooth roof over shiny cladding on a brick base, a round chimney, pipes and a canopy (24 x 18 x 21 m)."""
    b = Builder()
    x, y, foot, eaves, rise, bays = 12.0, 9.0, 1.2, 5.6, 2.4, 4
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    gates = [Opening(3.0, 0.0, 6.6, 4.0, "gate"), Opening(9.5, 0.0, 13.1, 4.0, "gate")]
    for i, name in enumerate(("south", "east", "north", "west")):
        ends = corners[i], corners[(i + 1) % 4]
        length = 24.0 if i % 2 == 0 else 18.0
        holes = gates if name == "south" else []
        b.wall(*ends, (0, foot), "brick", [Opening(g.u0, 0.0, g.u1, foot, "void") for g in holes], f"{name}.base")
        upper = [Opening(g.u0, 0.0, g.u1, g.v1 - foot, "gate") for g in holes] or wall_row(length, 5, 2.2, 1.4, 1.3)
        b.wall(*ends, (foot, eaves), wall, upper, name, casing=_PLAIN)
    depth = 2 * y / bays
    for k in range(bays):
        low, high = -y + k * depth, -y + (k + 1) * depth
        _sawtooth(b, x, (low, high), (eaves, eaves + rise), f"roof.{k}")
    _chimney(b, (x + 3.0, 3.0), 20.0)
    for z in (3.4, 4.0):
        b.beam((x + 0.3, -y, z), (x + 0.3, y, z), 0.22, "steel", "pipes")
    b.box((-9.4, -y - 3.0, 4.4), (2.0, -y, 4.6), "metal", "canopy")
    for px in (-9.2, -3.7, 1.8):
        b.beam((px, -y - 2.8, 0.0), (px, -y - 2.8, 4.4), 0.14, "steel", "canopy.posts")
    return b.parts()


def _sawtooth(b: Builder, x: float, span: tuple[float, float], heights: tuple[float, float], element: str) -> None:
    """One tooth: a slope that rises to the north, its glazing upright, its ends closed."""
    (low, high), (eaves, top) = span, heights
    b.polygon([(-x, low, eaves), (x, low, eaves), (x, high, top), (-x, high, top)], "sheet", element)
    b.polygon([(x, high, eaves), (-x, high, eaves), (-x, high, top), (x, high, top)], "glass", f"{element}.lights")
    for px in np.linspace(-x, x, 13):
        b.box((px - 0.05, high, eaves), (px + 0.05, high + 0.08, top), "frame", f"{element}.lights")
    b.box((-x - 0.15, high - 0.15, top - 0.05), (x + 0.15, high + 0.2, top + 0.12), "metal", element)
    b.polygon([(x, low, eaves), (x, high, eaves), (x, high, top)], "shiny_sheet", f"{element}.ends")
    b.polygon([(-x, high, eaves), (-x, low, eaves), (-x, high, top)], "shiny_sheet", f"{element}.ends")


def _chimney(b: Builder, centre: Corner, height: float) -> None:
    """A round stack of brick that narrows, with a ring of stone at its head."""
    levels = np.linspace(0.0, height, 9)
    radii = np.linspace(1.3, 0.8, 9)
    for (z0, z1), (r0, r1) in zip(pairwise(levels), pairwise(radii), strict=True):
        low, high = ring_points(centre, r0, 0, 360, 24), ring_points(centre, r1, 0, 360, 24)
        for a, c, d, e in zip(low, low[1:], high[1:], high, strict=False):
            b.polygon([(*a, z0), (*c, z0), (*d, z1), (*e, z1)], "brick", "chimney")
    head = ring_points(centre, 1.0, 0, 360, 24)
    drum(b, head, height - 0.8, height + 0.3, "stone", "chimney.head")
    b.polygon([(*p, height + 0.3) for p in head[:-1]], "metal", "chimney.head")
    b.polygon([(*p, height - 0.8) for p in head[:-1]][::-1], "stone", "chimney.head")


def rotunda(wall: str = "plaster") -> list[Part]:
    """A round hall under a copper dome with a lantern, a portico of columns before it (18 x 22 x 19 m)."""
    b = Builder()
    radius, top, count = 8.0, 8.4, 24
    ring = ring_points((0.0, 0.0), radius, 0, 360, count)
    for i, (a, c) in enumerate(pairwise(ring)):
        front = 16 <= i <= 19
        chord = float(np.hypot(c[0] - a[0], c[1] - a[1]))
        door = [Opening(chord / 2 - 0.7, 0.8, chord / 2 + 0.7, 4.0, "door")] if i == 17 else []
        holes = door if front else [Opening(chord / 2 - 0.5, 3.6, chord / 2 + 0.5, 6.4)] if i % 2 == 0 else []
        b.wall(a, c, (0, top), wall, holes, f"drum{i}")
    _ring_band(b, radius + 0.3, (top, top + 0.5), "stone", "cornice")
    _ring_band(b, radius + 0.15, (0.0, 0.9), "stone", "plinth")
    _dome(b, (0.0, 0.0, top + 0.5), radius + 0.1, 6.4, "copper")
    lantern = ring_points((0.0, 0.0), 1.1, 0, 360, 16)
    drum(b, lantern, top + 6.3, top + 8.4, wall, "lantern")
    cone(b, ring_points((0.0, 0.0), 1.4, 0, 360, 16), top + 8.4, (0.0, 0.0, top + 10.2), "copper", "stone", "lantern")
    _portico(b, radius)
    return b.parts()


def _ring_band(b: Builder, radius: float, z: tuple[float, float], material: str, element: str) -> None:
    """A closed round plate."""
    rim = ring_points((0.0, 0.0), radius, 0, 360, 48)
    drum(b, rim, *z, material, element)
    b.polygon([(*p, z[1]) for p in rim[:-1]], material, element)
    b.polygon([(*p, z[0]) for p in rim[:-1]][::-1], material, element)


def _dome(b: Builder, foot: tuple[float, float, float], radius: float, rise: float, material: str) -> None:
    """Half an ellipsoid with ribs."""
    angles = np.linspace(0.0, np.pi / 2, 11)[:-1]
    rings = [ring_points(foot[:2], radius * float(np.cos(t)), 0, 360, 48) for t in angles]
    heights = [foot[2] + rise * float(np.sin(t)) for t in angles]
    for (low, high), (z0, z1) in zip(pairwise(rings), pairwise(heights), strict=True):
        for a, c, d, e in zip(low, low[1:], high[1:], high, strict=False):
            b.polygon([(*a, z0), (*c, z0), (*d, z1), (*e, z1)], material, "dome")
        for k in range(0, 48, 6):
            b.beam((*low[k], z0), (*high[k], z1), 0.16, material, "dome.ribs")
    b.polygon([(*p, heights[-1]) for p in rings[-1][:-1]], material, "dome")


def _portico(b: Builder, radius: float) -> None:
    """Six steps, four round columns, an entablature and a gable roof towards the south."""
    half, front, back, eaves, ridge = 5.0, -radius - 4.0, -radius + 1.6, 6.4, 8.2
    for i in range(4):
        b.box(
            (-half - 0.3 * (3 - i), front - 0.3 * (3 - i), 0.2 * i),
            (half + 0.3 * (3 - i), back, 0.2 * (i + 1)),
            "stone",
            "steps",
        )
    for px in np.linspace(-half + 0.7, half - 0.7, 4):
        shaft = ring_points((float(px), front + 0.7), 0.42, 0, 360, 16)
        drum(b, shaft, 0.8, eaves - 0.7, "stone", "columns")
        for z in (0.8, eaves - 1.0):
            b.box((px - 0.55, front + 0.15, z), (px + 0.55, front + 1.25, z + 0.3), "stone", "columns")
    b.box((-half, front, eaves - 0.7), (half, back, eaves), "stone", "entablature")
    for side in (-1, 1):
        edge = side * (half + 0.3)
        quad = [(edge, front - 0.3, eaves), (edge, back, eaves), (0, back, ridge), (0, front - 0.3, ridge)]
        b.roof_slab(quad if side > 0 else quad[::-1], 0.2, "copper", "stone", "roof.portico")
    gable = [(-half, front + 0.3, eaves), (half, front + 0.3, eaves), (0, front + 0.3, ridge - 0.2)]
    b.polygon(gable, "plaster", "pediment")


def modern_house(wall: str = "clean_white") -> list[Part]:
    """White cubes, one cantilevered over a terrace, large panes, a screen of lamellas, a pergola (16 x 12 x 7 m)."""
    b = Builder()
    _cube(
        b,
        (-8.0, -4.0, 0.0),
        (3.0, 5.0, 3.4),
        wall,
        {
            "south": [Opening(1.2, 0.1, 5.4, 2.7, "void")],
            "west": [Opening(1.0, 1.0, 2.6, 2.4), Opening(5.0, 1.0, 6.6, 2.4)],
            "north": [Opening(2.0, 0.0, 3.1, 2.2, "door"), Opening(5.5, 1.6, 9.0, 2.4)],
        },
        "ground",
    )
    _cube(
        b,
        (-5.0, -7.0, 3.4),
        (2.0, 4.0, 6.6),
        wall,
        {
            "south": [Opening(0.8, 0.5, 6.2, 2.7, "void")],
            "east": [Opening(2.0, 0.9, 3.4, 2.3), Opening(6.5, 0.9, 8.0, 2.3)],
            "west": [Opening(3.0, 0.4, 5.0, 2.7, "void")],
            "north": [Opening(2.2, 1.2, 4.8, 2.0)],
        },
        "upper",
    )
    _cube(
        b,
        (3.0, -1.0, 0.0),
        (8.0, 5.0, 2.8),
        "cladding",
        {"south": [Opening(0.9, 0.0, 4.1, 2.3, "gate")], "east": [], "north": []},
        "garage",
    )
    for px in np.arange(-7.9, -5.2, 0.22):
        b.box((px, -4.35, 0.0), (px + 0.07, -4.2, 3.4), "wood", "screen")
    for py in np.arange(-6.4, -1.0, 0.8):
        b.box((3.0, py, 2.5), (7.6, py + 0.12, 2.7), "wood", "pergola")
    for px, py in ((7.4, -6.4), (7.4, -1.4)):
        b.beam((px, py, 0.0), (px, py, 2.5), 0.15, "wood", "pergola")
    b.beam((7.4, -6.5, 2.42), (7.4, -1.0, 2.42), 0.15, "wood", "pergola")
    b.box((-2.0, 1.0, 6.2), (-1.2, 1.8, 7.8), "metal", "flue")
    return b.parts()


def _cube(
    b: Builder,
    low: tuple[float, float, float],
    high: tuple[float, float, float],
    wall: str,
    holes: dict[str, list[Opening]],
    element: str,
) -> None:
    """A box with a flat roof behind a parapet; openings of the kind void get one mirroring pane."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    for i, name in enumerate(("south", "east", "north", "west")):
        ends, openings = (corners[i], corners[(i + 1) % 4]), holes.get(name, [])
        b.wall(*ends, (z0, z1), wall, openings, f"{element}.{name}", casing=Casing(0.15, "metal_door", False))
        frame = WallFrame.make(*ends, z0)
        for k, o in enumerate(hole for hole in openings if hole.kind == "void"):
            b.polygon(frame.rectangle(o.u0, o.v0, o.u1, o.v1, -0.15), "mirror_glass", f"{element}.{name}.pane{k}")
            for u in np.linspace(o.u0, o.u1, 4):
                low_, high_ = frame.point(u, o.v0, -0.12), frame.point(u, o.v1, -0.12)
                b.beam(low_, high_, 0.06, "metal_door", f"{element}.{name}.pane{k}")
    b.polygon([(*c, z1 - 0.3) for c in corners], "gravel", f"roof.{element}")
    b.polygon([(*c, z0) for c in corners][::-1], wall, f"{element}.under")
    cx, cy = (x0 + x1) / 2, (y0 + y1) / 2
    rim = Builder()
    band(rim, (x1 - x0) / 2, (y1 - y0) / 2, (-0.25, 0.03), (z1 - 0.3, z1 + 0.02), "metal", f"{element}.parapet")
    for part in rim.parts():
        b.mesh(part.vertices + np.array([cx, cy, 0.0]), part.faces, part.material, part.element)


def farm(wall: str = "ashlar") -> list[Part]:
    """A stone barn with a boarded gable and solar panels, a wing at right angles, a lean-to (22 x 18 x 10 m)."""
    b = Builder()
    x, y, eaves, ridge = 11.0, 5.0, 4.6, 9.4
    holes = [Opening(8.8, 0.0, 13.0, 3.9, "gate"), *(Opening(u, 1.2, u + 0.9, 2.2) for u in (2.0, 5.2, 16.0, 19.0))]
    b.wall((-x, -y), (x, -y), (0, eaves), wall, holes, "south")
    b.wall((x, -y), (x, y), (0, eaves), wall, [Opening(4.4, 0.0, 5.6, 2.3, "door")], "east")
    b.wall((x, y), (-x, y), (0, eaves), wall, wall_row(22, 6, 0.8, 1.4, 1.0), "north")
    b.wall((-x, y), (-x, -y), (0, eaves), wall, wall_row(10, 3, 0.8, 1.4, 1.0), "west")
    for side in (1, -1):
        edge = side * x
        gable = [(edge, -side * y, eaves), (edge, side * y, eaves), (edge, 0.0, ridge)]
        b.polygon(gable, "cladding", "gable")
    slope = (ridge - eaves) / y
    over, low = 0.6, eaves - slope * 0.6 + 0.2
    south = [
        (-x - over, -y - over, low),
        (x + over, -y - over, low),
        (x + over, 0, ridge + 0.2),
        (-x - over, 0, ridge + 0.2),
    ]
    b.roof_slab(south, 0.2, "tiles", "wood_trim", "roof.south")
    b.roof_slab([(px, -py, z) for px, py, z in south][::-1], 0.2, "tiles", "wood_trim", "roof.north")
    _panels(b, (-7.5, 4.5), (-4.2, -1.2), lambda py: ridge + 0.2 + slope * py)
    wing_ridge = 7.2
    for px in (-10.0, -4.0):
        ends = ((px, y + 8.0), (px, y)) if px < -5 else ((px, y), (px, y + 8.0))
        b.wall(*ends, (0, 3.4), "clay", wall_row(8, 3, 1.0, 1.0, 1.2), "wing")
    b.wall((-4.0, y + 8.0), (-10.0, y + 8.0), (0, 3.4), "clay", wall_row(6, 2, 1.0, 1.0, 1.2), "wing.end", gable=3.8)
    for side in (-1, 1):
        edge = -7.0 + side * 3.4
        foot = 3.4 - 0.4 * 3.8 / 3.0 + 0.2
        quad = [(edge, 1.5, foot), (edge, y + 8.4, foot), (-7.0, y + 8.4, wing_ridge + 0.2), (-7.0, 1.5, 7.4)]
        b.roof_slab(quad if side > 0 else quad[::-1], 0.2, "slate", "wood_trim", "roof.wing")
    lean = [(x, -3.5, 3.4), (x, 4.0, 3.4), (x + 3.4, 4.0, 2.2), (x + 3.4, -3.5, 2.2)]
    b.roof_slab(lean[::-1], 0.08, "shiny_sheet", "metal", "roof.lean_to")
    for py in (-3.2, 0.2, 3.7):
        b.beam((x + 3.2, py, 0.0), (x + 3.2, py, 2.2), 0.2, "timber", "posts")
    return b.parts()


def _panels(
    b: Builder, along: tuple[float, float], across: tuple[float, float], height_at: Callable[[float], float]
) -> None:
    """Solar panels 12 cm above a slope: dark, mirroring, in frames of aluminium."""
    for px in np.arange(along[0], along[1] - 1.0, 1.7):
        for py in np.arange(across[0], across[1] - 0.9, 1.0):
            quad = [(px, py, 0.0), (px + 1.6, py, 0.0), (px + 1.6, py + 0.94, 0.0), (px, py + 0.94, 0.0)]
            raised = [(qx, qy, height_at(qy) + 0.12) for qx, qy, _ in quad]
            b.roof_slab(raised, 0.05, "spandrel", "alu", "panels")
