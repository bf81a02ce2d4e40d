# SPDX-License-Identifier: GPL-3.0-or-later
"""Houses of the synthetic scenes whose materials are hard on photogrammetry: plain plaster, timber, wood, slate."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from benchmarks.roofs import Corner, band, gable_roof, hip_roof, lean_to
from benchmarks.shapes import Builder, Casing, Opening, Part, WallFrame, wall_row


def plain_house(wall: str = "clean_white") -> list[Part]:
    """A house of clean plaster with few windows under a hip roof of one colour, and a lower annex (18 x 10 x 10 m)."""
    b = Builder()
    x, y, eaves, ridge = 6.0, 4.75, 6.0, 9.3
    upper = [Opening(2.0, 3.9, 3.2, 5.2), Opening(8.8, 3.9, 10.0, 5.2)]
    south = [*upper, Opening(5.4, 0.0, 6.5, 2.2, "door"), Opening(8.5, 1.0, 10.2, 2.3)]
    north = [Opening(2.1, 1.3, 3.1, 2.2), Opening(8.2, 4.0, 9.2, 5.1)]
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    holes = (south, [Opening(6.8, 4.75, 7.7, 5.55)], north, [Opening(4.2, 3.9, 5.4, 5.2)])
    for i, (name, some) in enumerate(zip(("south", "east", "north", "west"), holes, strict=True)):
        b.wall(corners[i], corners[(i + 1) % 4], (0, eaves), wall, some, name, casing=Casing(trim=wall, surround=False))
    hip_roof(b, (-x, -y), (x, y), eaves, ridge, 0.4, "clean_red", "wood_trim")
    _annex(b, wall, x, (-3.2, 3.4))
    b.box((1.6, 0.8, 8.0), (2.3, 1.6, 10.0), wall, "chimney")
    b.box((1.52, 0.72, 10.0), (2.38, 1.68, 10.12), "metal", "chimney")
    band(b, x, y, (0.0, 0.025), (0.0, 0.3), "concrete", "plinth")
    for px, py in ((-x - 0.07, -y + 0.4), (-x - 0.07, y - 0.4)):
        b.beam((px, py, 0.0), (px, py, eaves), 0.09, "metal", "downpipe")
    return b.parts()


def _annex(b: Builder, wall: str, x: float, y: tuple[float, float]) -> None:
    """A garage under a lean-to roof at the east side."""
    (y0, y1), end, eaves, top = y, x + 6.0, 2.9, 4.2
    gate = [Opening(1.7, 0.0, 4.3, 2.2, "gate")]
    for left, right, holes in (((x, y0), (end, y0), gate), ((end, y0), (end, y1), []), ((end, y1), (x, y1), [])):
        b.wall(left, right, (0, eaves), wall, holes, "annex", casing=Casing(trim=wall, surround=False))
    b.polygon([(x, y0, eaves), (end, y0, eaves), (x, y0, top)], wall, "annex")
    b.polygon([(end, y1, eaves), (x, y1, eaves), (x, y1, top)], wall, "annex")
    lean_to(b, (x, y0), (end, y1), eaves, top, 0.3, "clean_red")


def half_timber(wall: str = "clay") -> list[Part]:
    """A stone ground floor, a timber-framed storey that juts out, and a steep tiled roof (11 x 9 x 11 m)."""
    b = Builder()
    x, y, jut = 5.0, 4.0, 0.3
    lower = [
        [Opening(1.0, 0.9, 2.2, 2.1), Opening(4.4, 0.0, 5.6, 2.2, "door"), Opening(7.6, 0.9, 8.8, 2.1)],
        [Opening(3.2, 0.9, 4.6, 2.1)], [Opening(1.4, 0.9, 2.4, 2.0), Opening(6.6, 0.9, 7.8, 2.0)], [],
    ]  # fmt: skip
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    for i, name in enumerate(("south", "east", "north", "west")):
        b.wall(corners[i], corners[(i + 1) % 4], (0, 2.8), "ashlar", lower[i], f"{name}.ground")
    x, y, eaves, ridge = x + jut, y + jut, 5.5, 11.0
    b.polygon([(-x, y, 2.8), (x, y, 2.8), (x, -y, 2.8), (-x, -y, 2.8)], "timber", "jetty")
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    for i, (name, cells, holes) in enumerate((("south", 9, (1, 4, 7)), ("east", 7, (2, 4)), ("north", 9, (2, 6)),
                                              ("west", 7, (3,)))):  # fmt: skip
        gable = ridge - eaves if i % 2 else 0.0
        _timber_wall(b, wall, (corners[i], corners[(i + 1) % 4]), (2.8, eaves), cells, holes, name, gable)
    gable_roof(b, x, y, eaves, ridge, 0.5)
    b.box((-2.2, 0.3, 9.0), (-1.5, 1.0, 11.9), "brick", "chimney")
    return b.parts()


def _timber_wall(
    b: Builder, wall: str, ends: tuple[Corner, Corner], heights: tuple[float, float], cells: int,
    windows: tuple[int, ...], name: str, gable: float,
) -> None:  # fmt: skip
    """A wall of filled cells between posts, rails and braces that stand out by some centimetres."""
    foot, top = heights
    frame = WallFrame.make(*ends, foot)
    pitch, height, thick, rail = frame.length / cells, top - foot, 0.17, 1.0
    holes = [Opening(i * pitch + 0.1, rail, (i + 1) * pitch - 0.1, 2.2) for i in windows]
    b.wall(*ends, (foot, top), wall, holes, name, gable=gable, casing=Casing(depth=0.12, trim="timber", surround=False))

    def beam(u0: float, v0: float, u1: float, v1: float) -> None:
        b.beam(frame.point(u0, v0, -0.04), frame.point(u1, v1, -0.04), thick, "timber", f"{name}.timber")

    for i in range(cells + 1):
        beam(i * pitch, 0.0, i * pitch, height)
    for v in (0.08, rail, height - 0.08):
        beam(0.0, v, frame.length, v)
    for start, end in ((0.1, pitch), (frame.length - 0.1, frame.length - pitch)):
        if not any(o.u0 < (start + end) / 2 < o.u1 for o in holes):
            beam(start, height - 0.1, end, rail)
    for i in range(1, cells) if gable else ():
        beam(i * pitch, height, i * pitch, height + gable * (1 - abs(2 * i / cells - 1)) - 0.25)
    if gable:
        beam(0.3 * frame.length, height + 0.55 * gable, 0.7 * frame.length, height + 0.55 * gable)


def slate_villa(wall: str = "slate") -> list[Part]:
    """Walls hung with slate, a mansard of dark standing-seam metal with dormers, a bay in front (12 x 10 x 11 m)."""
    b = Builder()
    x, y, eaves = 6.0, 5.0, 6.4
    rows = [h for foot in (1.0, 4.0) for h in wall_row(2 * x, 4, 1.1, foot, 1.6)]
    south = [h for h in rows if h.u0 < 3 or h.u0 > 8]
    ends = [h for foot in (1.0, 4.0) for h in wall_row(2 * y, 3, 1.0, foot, 1.6)]
    east = [h for h in ends if h.v0 > 2 or h.u0 > 3] + [Opening(0.8, 0.0, 1.9, 2.3, "door")]
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    for i, (name, holes) in enumerate((("south", south), ("east", east), ("north", rows), ("west", ends))):
        b.wall(corners[i], corners[(i + 1) % 4], (0, eaves), wall, holes, name, casing=Casing(trim="dark_metal"))
    _mansard(b, x, y, eaves)
    bay = [(-2.0, -y), (-1.3, -y - 1.3), (1.3, -y - 1.3), (2.0, -y)]
    for (a, c), hole in zip(pairwise(bay), (None, (0.3, 2.3), None), strict=True):
        panes = [] if hole is None else [Opening(hole[0], foot, hole[1], foot + 1.7) for foot in (0.9, 4.0)]
        b.wall(a, c, (0, 6.2), "dark_metal", panes, "bay", casing=Casing(trim="dark_metal", surround=False))
    b.polygon([(px, py, 6.2) for px, py in bay], "dark_metal", "bay.roof")
    band(b, x, y, (0.0, 0.06), (0.0, 0.5), "stone", "plinth")
    for px in (-4.2, 3.3):
        b.box((px, 0.2, 8.5), (px + 0.8, 1.2, 12.2), "brick", "chimneys")
    return b.parts()


def _mansard(b: Builder, x: float, y: float, eaves: float) -> None:
    """A steep storey of metal with four dormers, under a shallow hip."""
    inset, knee = 1.3, eaves + 2.9
    low = [(-x - 0.3, -y - 0.3), (x + 0.3, -y - 0.3), (x + 0.3, y + 0.3), (-x - 0.3, y + 0.3)]
    high = [(-x + inset, -y + inset), (x - inset, -y + inset), (x - inset, y - inset), (-x + inset, y - inset)]
    for i, name in enumerate(("south", "east", "north", "west")):
        j = (i + 1) % 4
        steep = [(*low[i], eaves), (*low[j], eaves), (*high[j], knee), (*high[i], knee)]
        b.polygon(steep, "dark_metal", f"roof.{name}")
    b.polygon([(*p, eaves) for p in low[::-1]], "wood_trim", "")
    hip_roof(b, high[0], high[2], knee - 0.2, knee + 1.0, 0.15, "dark_metal", "dark_metal")
    for px, side in ((-3.2, -1), (3.2, -1), (-3.2, 1), (3.2, 1)):
        front, back = side * (y - 0.05), side * (y - inset - 0.2)
        left, right = ((px - 0.8, front), (px + 0.8, front))[::-side]
        pane, casing = [Opening(0.25, 0.2, 1.35, 1.6)], Casing(trim="dark_metal", surround=False)
        b.wall(left, right, (eaves + 0.5, eaves + 2.3), "dark_metal", pane, "dormer", casing=casing)
        low_y, high_y = sorted((front - side * 0.02, back))
        for edge in (px - 0.8, px + 0.74):
            b.box((edge, low_y, eaves + 0.5), (edge + 0.06, high_y, eaves + 2.3), "dark_metal", "dormer")
        low_y, high_y = sorted((front + side * 0.2, back))
        b.box((px - 0.95, low_y, eaves + 2.3), (px + 0.95, high_y, eaves + 2.42), "dark_metal", "dormer")


def bungalow(wall: str = "cladding") -> list[Part]:
    """A low wooden house of two wings with a veranda and wide eaves, to stand among trees (17 x 13 x 5.5 m)."""
    b = Builder()
    x, y, eaves = 8.0, 3.6, 2.7
    south = [Opening(1.0, 0.9, 2.8, 2.1), Opening(4.0, 0.9, 5.4, 2.1), Opening(6.3, 0.0, 7.3, 2.1, "door")]
    north = [*wall_row(16.0, 5, 1.3, 1.0, 1.1)]
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    holes = (south, [Opening(2.4, 0.2, 4.8, 2.2)], north, [Opening(2.8, 1.0, 4.2, 2.1)])
    for i, (name, some) in enumerate(zip(("south", "east", "north", "west"), holes, strict=True)):
        b.wall(
            corners[i], corners[(i + 1) % 4], (0, eaves), wall, some, name, casing=Casing(depth=0.12, trim="wood_trim")
        )
    hip_roof(b, (-x, -y), (x, y), eaves, 4.9, 0.7, "felt", "wood_trim")
    x0, x1, front = 1.5, 7.5, -y - 5.0
    sides: list[tuple[Corner, Corner, list[Opening]]] = [
        ((x0, front), (x1, front), [Opening(1.2, 0.3, 4.8, 2.2)]), ((x1, front), (x1, -y), []),
        ((x0, -y), (x0, front), [Opening(1.6, 0.9, 3.2, 2.1)]),
    ]  # fmt: skip
    for left, right, some in sides:
        b.wall(left, right, (0, eaves), wall, some, "wing", casing=Casing(depth=0.12, trim="wood_trim"))
    b.polygon([(x0, front, eaves), (x1, front, eaves), (4.5, front, 4.4)], wall, "wing")
    for edge, quad in ((x0, ((x0 - 0.5, 2.62), (4.5, 4.55))), (x1, ((x1 + 0.5, 2.62), (4.5, 4.55)))):
        (u0, z0), (u1, z1) = quad
        corner = [(u0, front - 0.6, z0), (u0, -1.0, z0), (u1, -1.0, z1), (u1, front - 0.6, z1)]
        b.roof_slab(corner if edge == x1 else corner[::-1], 0.15, "felt", "wood_trim", "roof.wing")
    b.box((-7.6, -y - 2.2, 0.0), (1.4, -y, 0.2), "wood", "veranda")
    b.roof_slab([(-7.8, -y - 2.4, 2.3), (1.4, -y - 2.4, 2.3), (1.4, -y, 2.75), (-7.8, -y, 2.75)], 0.1, "felt",
                "wood_trim", "roof.veranda")  # fmt: skip
    for px in np.linspace(-7.5, 1.2, 5):
        b.box((px, -y - 2.2, 0.2), (px + 0.12, -y - 2.08, 2.25), "wood_trim", "veranda")
    b.box((-5.2, 0.4, 3.0), (-4.2, 1.2, 5.6), "ashlar", "chimney")
    return b.parts()


def brick_wings(wall: str = "brick") -> list[Part]:
    """Two gabled wings of brick and a hall between them, around a court that is open to the south (28 x 20 x 9 m)."""
    b = Builder()
    eaves, ridge, over = 6.0, 9.2, 0.4
    outline = [(-14, -10), (-6, -10), (-6, 3), (6, 3), (6, -10), (14, -10), (14, 10), (6, 10), (-6, 10), (-14, 10)]
    gables = (0, 4, 6, 8)  # the wings' ends
    for i, left in enumerate(outline):
        right = outline[(i + 1) % len(outline)]
        length = float(np.hypot(*np.subtract(right, left)))
        holes = wall_row(length, max(2, round(length / 3)), 1.3, 1.2, 2.4)
        if i == 2:
            holes[1:-1] = [Opening(length / 2 - 0.9, 0.0, length / 2 + 0.9, 2.8, "door")]
        b.wall(left, right, (0, eaves), wall, holes, f"side {i}", gable=ridge - eaves if i in gables else 0.0)
    for middle in (-10.0, 10.0):
        _ridged(b, (middle, 0.0), (10.0, 4.0), (eaves, ridge), over, along_y=True)
    _ridged(b, (0.0, 6.5), (9.0, 3.5), (eaves, ridge - 0.4), over, along_y=False)
    b.box((-10.4, 4.0, 8.0), (-9.6, 4.9, 10.6), wall, "chimneys")
    return b.parts()


def _ridged(b: Builder, middle: Corner, half: Corner, heights: tuple[float, float], over: float, along_y: bool) -> None:
    """Two tiled slopes over a rectangle; half sizes along and across the ridge, heights of eaves and ridge."""
    (length, width), (eaves, ridge) = half, heights
    low = eaves - (ridge - eaves) / width * over
    for side in (-1.0, 1.0):
        slope = [(-length - over, side * (width + over), low), (length + over, side * (width + over), low),
                 (length + over, 0.0, ridge), (-length - over, 0.0, ridge)]  # fmt: skip
        placed = [(middle[0] - v, middle[1] + u, z + 0.12) if along_y else (middle[0] + u, middle[1] + v, z + 0.12)
                  for u, v, z in slope]  # fmt: skip
        b.roof_slab(placed if side < 0 else placed[::-1], 0.18, "tiles", "wood_trim", "roof")
