# SPDX-License-Identifier: GPL-3.0-or-later
"""Glass buildings of the synthetic scenes: curtain walls, a show-room, a block and a tower."""

from __future__ import annotations

import numpy as np

from benchmarks.roofs import Corner, band
from benchmarks.shapes import Builder, Casing, Opening, Part, WallFrame, wall_row


def glass_office(wall: str = "mirror_glass") -> list[Part]:
    """Five storeys of curtain wall, mirroring panes between mullions, on a flat roof a plant room (21 x 14 x 19 m)."""
    b = Builder()
    x, y, floors, storey = 10.5, 7.0, 5, 3.4
    height = floors * storey
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    for i, name in enumerate(("south", "east", "north", "west")):
        _curtain(b, wall, (corners[i], corners[(i + 1) % 4]), floors, storey, name)
    for px, py in corners:
        b.box((px - 0.15, py - 0.15, 0), (px + 0.15, py + 0.15, height), "alu", "corners")
    b.polygon([(px, py, height - 0.3) for px, py in corners], "gravel", "roof")
    band(b, x, y, (-0.35, 0.12), (height - 0.4, height + 0.5), "alu", "parapet")
    b.box((-5.0, -2.5, height - 0.3), (3.5, 3.0, height + 2.2), "sheet", "plant")
    b.box((6.0, -1.0, height - 0.3), (7.6, 0.6, height + 1.2), "metal", "plant")
    b.box((-2.4, -y - 2.2, 3.0), (2.4, -y, 3.2), "alu", "canopy")
    for px in (-2.2, 2.06):
        b.box((px, -y - 2.1, 0), (px + 0.14, -y - 1.96, 3.0), "alu", "canopy")
    return b.parts()


def _curtain(
    b: Builder, glass: str, ends: tuple[Corner, Corner], floors: int, storey: float, name: str, foot: float = 0.0
) -> None:
    """Panes and spandrels flush with each other, mullions and transoms in front of them, from height ``foot`` up."""
    frame = WallFrame.make(*ends, foot)
    count = round(frame.length / 1.5)
    pitch, up = frame.length / count, np.array([0.0, 0.0, 1.0])
    axes = np.stack([frame.along, up, frame.out])
    for i in range(count):
        for k in range(floors):
            low, sill, top = k * storey, k * storey + 0.9, (k + 1) * storey
            if k:
                b.polygon(frame.rectangle(i * pitch, low, (i + 1) * pitch, sill, 0.0), "spandrel", f"{name}.spandrel")
            pane = frame.rectangle(i * pitch, sill if k else low, (i + 1) * pitch, top, 0.0)
            b.polygon(pane, glass, f"{name}.pane")
    half = floors * storey / 2
    for i in range(count + 1):
        b.bar(frame.point(i * pitch, half, 0.05), axes, (0.035, half, 0.07), "alu", f"{name}.mullions")
    for k in range(1, floors + 1):
        for v in (k * storey, k * storey + 0.9)[: 2 if k < floors else 1]:
            middle = frame.point(frame.length / 2, v, 0.03)
            b.bar(middle, axes, (frame.length / 2, 0.03, 0.05), "alu", f"{name}.mullions")


def glass_showroom(wall: str = "mirror_glass") -> list[Part]:
    """A glazed hall of two storeys between slabs of concrete, joined to a plastered workshop (24 x 17 x 10 m)."""
    b = Builder()
    x, y, storey = 8.0, 5.0, 4.2
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    for i, name in enumerate(("south", "east", "north", "west")):
        ends = corners[i], corners[(i + 1) % 4]
        for k in range(2):
            _panes(b, wall, ends, (k * storey + 0.25, (k + 1) * storey - 0.15), f"{name}.{k}")
    for k in range(3):
        b.box(
            (-x - 0.5, -y - 0.5, max(0.0, k * storey - 0.15)),
            (x + 0.5, y + 0.5, k * storey + 0.25),
            "raw_concrete",
            "slabs",
        )
    b.box((-2.0, -1.5, 2 * storey + 0.25), (1.5, 1.8, 2 * storey + 1.8), "sheet", "plant")
    bx, by, top = 8.0, 7.0, 5.2
    yard = [(x, -by + 2), (x + bx, -by + 2), (x + bx, by + 2), (x, by + 2)]
    for i, name in enumerate(("south", "east", "north", "west")):
        length = float(np.hypot(*np.subtract(yard[(i + 1) % 4], yard[i])))
        holes = [Opening(length / 2 - 1.8, 0.0, length / 2 + 1.8, 3.4, "gate")] if i % 2 == 0 else (
            wall_row(length, 4, 1.4, 2.2, 1.3) if name == "east" else [])  # fmt: skip
        element, casing = f"workshop.{name}", Casing(surround=False)
        b.wall(yard[i], yard[(i + 1) % 4], (0, top), "clean_white", holes, element, casing=casing)
    b.polygon([(px, py, top - 0.3) for px, py in yard], "gravel", "workshop.roof")
    return b.parts()


def glass_block(wall: str = "mirror_glass") -> list[Part]:
    """Three storeys of curtain wall around two sides of a yard, at the end a stair tower of brick (26 x 20 x 13 m)."""
    b = Builder()
    floors, storey = 3, 3.2
    height = floors * storey
    corners = [(-13.0, -10.0), (9.0, -10.0), (9.0, 10.0), (-1.0, 10.0), (-1.0, 0.0), (-13.0, 0.0)]
    for i, corner in enumerate(corners):
        _curtain(b, wall, (corner, corners[(i + 1) % 6]), floors, storey, f"side {i}")
        b.box((corner[0] - 0.15, corner[1] - 0.15, 0), (corner[0] + 0.15, corner[1] + 0.15, height), "alu", "corners")
    b.polygon([(px, py, height - 0.2) for px, py in corners], "gravel", "roof")
    b.box((9.0, 2.0, 0), (13.0, 8.0, height + 2.6), "brick", "stairs")
    b.box((-9.0, -7.0, height - 0.2), (-5.5, -4.0, height + 1.6), "sheet", "plant")
    return b.parts()


def glass_tower(wall: str = "mirror_glass") -> list[Part]:
    """Eight storeys of curtain wall, mirroring panes between mullions, on a podium of sandstone (20 x 16 x 32 m)."""
    b = Builder()
    floors, storey, foot = 8, 3.2, 4.6
    height = foot + floors * storey
    podium = [(-10.0, -8.0), (10.0, -8.0), (10.0, 8.0), (-10.0, 8.0)]
    for i in range(4):
        length = float(np.hypot(*np.subtract(podium[(i + 1) % 4], podium[i])))
        b.wall(
            podium[i], podium[(i + 1) % 4], (0, foot), "sandstone", wall_row(length, 5, 1.8, 0.6, 2.8), f"podium {i}"
        )
    b.polygon([(px, py, foot - 0.3) for px, py in podium], "gravel", "podium.roof")
    corners = [(-7.5, -5.5), (6.0, -5.5), (6.0, 5.5), (-7.5, 5.5)]
    for i, corner in enumerate(corners):
        _curtain(b, wall, (corner, corners[(i + 1) % 4]), floors, storey, f"side {i}", foot)
        b.box(
            (corner[0] - 0.15, corner[1] - 0.15, foot), (corner[0] + 0.15, corner[1] + 0.15, height), "alu", "corners"
        )
    b.polygon([(px, py, height - 0.2) for px, py in corners], "gravel", "roof")
    b.box((-4.0, -2.0, height - 0.2), (1.0, 2.5, height + 1.9), "sheet", "plant")
    return b.parts()


def _panes(b: Builder, glass: str, ends: tuple[Corner, Corner], heights: tuple[float, float], name: str) -> None:
    """Panes as high as the storey, 2 m wide, between slim mullions that stand in front of them."""
    frame, (low, top) = WallFrame.make(*ends, 0.0), heights
    count = round(frame.length / 2.0)
    pitch = frame.length / count
    axes = np.stack([frame.along, np.array([0.0, 0.0, 1.0]), frame.out])
    b.polygon(frame.rectangle(0.0, low, frame.length, top, 0.0), glass, f"{name}.pane")
    for i in range(count + 1):
        middle = frame.point(i * pitch, (low + top) / 2, 0.04)
        b.bar(middle, axes, (0.04, (top - low) / 2, 0.06), "alu", f"{name}.mullions")
