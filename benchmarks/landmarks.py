# SPDX-License-Identifier: GPL-3.0-or-later
"""Large buildings of the synthetic scenes: brick and stone, shiny sheet, concrete with balconies, a chapel."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from benchmarks.roofs import Corner, band, cone, drum, gable_roof, gutter, ring_points
from benchmarks.shapes import Builder, Casing, Opening, Part, WallFrame, wall_row


def warehouse(wall: str = "brick") -> list[Part]:
    """Brick between pilasters over a floor of ashlar, gates, a slate roof with roof lights (20 x 11 x 13 m)."""
    b = Builder()
    x, y, base, eaves, ridge = 10.0, 5.5, 3.4, 8.8, 13.0
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    for i, (name, length) in enumerate((("south", 20.0), ("east", 11.0), ("north", 20.0), ("west", 11.0))):
        bays = 5 if length > 15 else 3
        low = wall_row(length, bays, 1.5, 1.0, 1.7)
        if name in ("south", "east"):
            low[bays // 2] = Opening(length / 2 - 1.2, 0.0, length / 2 + 1.2, 2.9, "gate")
        high = [h for v in (0.7, 3.2) for h in wall_row(length, bays, 1.1, v, 1.6)]
        gable = ridge - eaves if i % 2 else 0.0
        b.wall(
            corners[i], corners[(i + 1) % 4], (0, base), "ashlar", low, f"{name}.ground", casing=Casing(surround=False)
        )
        b.wall(corners[i], corners[(i + 1) % 4], (base, eaves), wall, high, name, gable=gable)
        frame = WallFrame.make(corners[i], corners[(i + 1) % 4], base)
        for k in range(bays + 1):
            u = min(max(k * length / bays, 0.25), length - 0.25)
            axes = np.stack([frame.along, np.array([0.0, 0.0, 1.0]), frame.out])
            b.bar(frame.point(u, (eaves - base) / 2, 0.06), axes, (0.25, (eaves - base) / 2, 0.06), wall, "pilasters")
    gable_roof(b, x, y, eaves, ridge, 0.35, "slate")
    band(b, x, y, (0.0, 0.16), (base - 0.15, base + 0.15), "stone", "string_course")
    band(b, x, y, (0.0, 0.2), (eaves - 0.4, eaves - 0.1), "stone", "cornice")
    slope = (ridge - eaves) / y
    for px in (-6.5, -1.0, 4.5):
        foot, top = (-3.6, ridge - 3.6 * slope + 0.3), (-2.4, ridge - 2.4 * slope + 0.3)
        quad = [(px, *foot), (px + 1.6, *foot), (px + 1.6, *top), (px, *top)]
        b.roof_slab(quad, 0.2, "glass", "metal", "roof.light")
    for px in (-7.5, 7.0):
        b.box((px, 1.0, 10.0), (px + 0.9, 1.9, 14.6), wall, "chimneys")
    b.beam((x - 0.2, 0.0, 11.4), (x + 1.5, 0.0, 11.4), 0.22, "steel", "crane")
    return b.parts()


def sheet_hall(wall: str = "shiny_sheet") -> list[Part]:
    """Two barrel vaults of shiny sheet side by side over corrugated walls, and a silo (24 x 25 x 12 m)."""
    b = Builder()
    x, spring, rise, span = 12.0, 5.2, 2.8, 10.0
    ribbon = [Opening(0.8 + 3.2 * i, 3.4, 3.4 + 3.2 * i, 4.6) for i in range(7)]
    b.wall((-x, -span), (x, -span), (0, spring), wall, ribbon, "south", casing=Casing(trim="metal", surround=False))
    b.wall((x, span), (-x, span), (0, spring), wall, ribbon, "north", casing=Casing(trim="metal", surround=False))
    angles = np.linspace(0, np.pi, 21)
    for name, middle in (("south", -span / 2), ("north", span / 2)):
        arc = [(middle - span / 2 * float(np.cos(t)), spring + rise * float(np.sin(t))) for t in angles]
        for (y0, z0), (y1, z1) in pairwise(arc):
            quad = [(-x - 0.3, y0, z0), (x + 0.3, y0, z0), (x + 0.3, y1, z1), (-x - 0.3, y1, z1)]
            b.roof_slab(quad, 0.12, "shiny_sheet", "metal", f"roof.{name}")
        for side, sx in (("east", 1), ("west", -1)):
            low, high = middle - span / 2, middle + span / 2
            ends = ((sx * x, low), (sx * x, high)) if sx > 0 else ((sx * x, high), (sx * x, low))
            gate = [Opening(3.0, 0.0, 7.0, 4.2, "gate")] if (side, name) != ("west", "north") else []
            b.wall(*ends, (0, spring), wall, gate, f"{side}.{name}", casing=Casing(trim="metal", surround=False))
            for (y0, z0), (y1, z1) in pairwise(arc):
                fan = [(sx * x, y0, spring), (sx * x, y1, spring), (sx * x, y1, z1), (sx * x, y0, z0)]
                b.polygon(fan if sx > 0 else fan[::-1], wall, f"{side}.tympanum")
    b.beam((-x - 0.3, 0.0, spring + 0.05), (x + 0.3, 0.0, spring + 0.05), 0.3, "metal", "roof.valley")
    for s in (-1, 1):
        b.beam((-x - 0.3, s * (span + 0.1), spring), (x + 0.3, s * (span + 0.1), spring), 0.15, "metal", "gutter")
    silo = ring_points((5.0, span + 3.0), 2.1, 0, 360, 32)
    drum(b, silo, 0.0, 9.8, "shiny_sheet", "silo")
    cone(b, silo, 9.8, (5.0, span + 3.0, 11.4), "shiny_sheet", "metal", "silo.roof")
    b.beam((5.0, span + 1.0, 9.4), (5.0, span - 3.0, spring + 2.5), 0.3, "metal", "silo.pipe")
    return b.parts()


def balcony_tower(wall: str = "raw_concrete") -> list[Part]:
    """A tower of eight storeys with two stacks of balconies on its long sides, railed with bars (13 x 11 x 29 m)."""
    b = Builder()
    x, y, floors, storey = 6.5, 5.5, 8, 3.1
    height = floors * storey + 0.8
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    for i, name in enumerate(("south", "east", "north", "west")):
        holes = []
        for k in range(floors):
            foot = k * storey + 0.4
            if i % 2:
                holes += wall_row(11.0, 3, 1.3, foot + 0.8, 1.4)
            else:
                holes += [Opening(u, foot, u + 2.2, foot + 2.3) for u in (1.4, 9.4)]
                low = foot + 0.8 if k or i else 0.05
                holes.append(Opening(5.9, low, 7.1, foot + 2.2, "window" if k or i else "door"))
        b.wall(
            corners[i], corners[(i + 1) % 4], (0, height), wall, holes, name, casing=Casing(trim=wall, surround=False)
        )
        for k in range(1, floors) if i % 2 == 0 else ():
            for u in (0.6, 8.6):
                _balcony(b, wall, WallFrame.make(corners[i], corners[(i + 1) % 4], k * storey + 0.2), u)
    b.polygon([(px, py, height - 0.5) for px, py in corners], "gravel", "roof")
    band(b, x, y, (-0.25, 0.0), (height - 0.5, height + 0.2), wall, "parapet")
    b.box((-2.0, -1.8, height - 0.5), (2.2, 1.8, height + 2.6), wall, "lift")
    b.box((-1.7, -y - 1.8, 2.75), (1.7, -y, 2.95), wall, "canopy")
    return b.parts()


def _balcony(b: Builder, wall: str, frame: WallFrame, u: float, length: float = 3.8, out: float = 1.3) -> None:
    """A slab with a railing of bars around three sides; ``frame`` has its origin at the slab's height."""
    axes = np.stack([frame.along, np.array([0.0, 0.0, 1.0]), frame.out])
    b.bar(frame.point(u + length / 2, 0.0, out / 2), axes, (length / 2, 0.09, out / 2), wall, "balconies")
    rim = [(u + 0.04, 0.0), (u + 0.04, out - 0.04), (u + length - 0.04, out - 0.04), (u + length - 0.04, 0.0)]
    for (u0, w0), (u1, w1) in pairwise(rim):
        for v in (0.2, 1.1):
            b.beam(frame.point(u0, v, w0), frame.point(u1, v, w1), 0.05, "steel", "railings")
        bars = max(2, round(float(np.hypot(u1 - u0, w1 - w0)) / 0.2))
        for t in np.linspace(0, 1, bars + 1):
            at = u0 + t * (u1 - u0), w0 + t * (w1 - w0)
            b.beam(frame.point(at[0], 0.09, at[1]), frame.point(at[0], 1.1, at[1]), 0.025, "steel", "railings")


def chapel(wall: str = "sandstone") -> list[Part]:
    """A nave with buttresses, a round apse, a round turret, a rose window and a dentilled cornice (20 x 11 x 17 m)."""
    b = Builder()
    x, y, eaves, ridge = 7.0, 4.2, 6.4, 11.0
    side = [Opening(1.9 + 3.4 * i, 1.8, 3.0 + 3.4 * i, 4.8) for i in range(4)]
    b.wall((-x, -y), (x, -y), (0, eaves), wall, side, "south")
    b.wall((x, y), (-x, y), (0, eaves), wall, side, "north")
    b.wall((x, -y), (x, y), (0, eaves), wall, (), "east", gable=ridge - eaves)
    b.wall((-x, y), (-x, -y), (0, eaves), wall, [Opening(3.3, 0.0, 5.1, 3.0, "door")], "west", gable=ridge - eaves)
    gable_roof(b, x, y, eaves, ridge, 0.3, "slate")
    for s in (-1, 1):
        for i in range(5):
            px = -6.6 + 3.3 * i
            low, high = sorted((s * y, s * (y + 0.7)))
            b.box((px - 0.28, low, 0.0), (px + 0.28, high, 4.6), "stone", "buttresses")
            b.box((px - 0.22, *sorted((s * y, s * (y + 0.4)))[:1], 4.6), (px + 0.22, max(s * y, s * (y + 0.4)), 5.5),
                  "stone", "buttresses")  # fmt: skip
        for px in np.arange(-6.8, 6.9, 0.42):
            low, high = sorted((s * y, s * (y + 0.14)))
            b.box((px - 0.1, low, eaves - 0.75), (px + 0.1, high, eaves - 0.5), "stone", "dentils")
        low, high = sorted((s * y, s * (y + 0.18)))
        b.box((-x, low, eaves - 0.5), (x, high, eaves - 0.3), "stone", "cornice")
        for hole in side:
            _arch(b, WallFrame.make((-x, -y), (x, -y), 0.0) if s < 0 else WallFrame.make((x, y), (-x, y), 0.0), hole)
    _rose(b, WallFrame.make((-x, y), (-x, -y), 0.0), (y, 6.4), 1.3)
    apse = ring_points((x, 0.0), 3.0, -90, 90, 16)
    drum(b, apse, 0.0, 5.0, wall, "apse")
    cone(b, ring_points((x, 0.0), 3.3, -90, 90, 16), 5.0, (x, 0.0, 7.6), "slate", "stone", "roof.apse")
    for px, py in ring_points((x, 0.0), 3.05, -60, 60, 4):
        b.box((px - 0.15, py - 0.15, 0.0), (px + 0.15, py + 0.15, 4.8), "stone", "pilasters")
    _round_turret(b, wall, (-x + 0.6, y + 0.8))
    return b.parts()


def _arch(b: Builder, frame: WallFrame, hole: Opening) -> None:
    """A round moulding over a window."""
    middle, radius = (hole.u0 + hole.u1) / 2, (hole.u1 - hole.u0) / 2 + 0.25
    angles = np.linspace(0, np.pi, 9)
    rim = [frame.point(middle + radius * np.cos(t), hole.v1 + 0.25 + 0.8 * radius * np.sin(t), 0.04) for t in angles]
    for a, c in pairwise(rim):
        b.beam(a, c, 0.16, "stone", "arches")


def _rose(b: Builder, frame: WallFrame, centre: Corner, radius: float) -> None:
    """A round window in relief: a disc of glass, a rim, twelve spokes."""

    def at(t: float, r: float, w: float) -> np.ndarray:
        return frame.point(centre[0] + r * np.cos(t), centre[1] + r * np.sin(t), w)

    angles = np.linspace(0, 2 * np.pi, 25)
    b.polygon([at(t, radius, 0.03) for t in angles[:-1]], "glass", "rose")
    for a, c in pairwise(angles):
        b.beam(at(a, radius, 0.06), at(c, radius, 0.06), 0.24, "stone", "rose")
    for t in angles[:-1:2]:
        b.beam(at(t, 0.25, 0.05), at(t, radius, 0.05), 0.09, "stone", "rose")


def _round_turret(b: Builder, wall: str, centre: Corner) -> None:
    """A slim round tower with a gallery of stone and a pointed copper roof."""
    body = ring_points(centre, 1.7, 0, 360, 28)
    drum(b, body, 0.0, 11.5, wall, "turret")
    for foot, out in ((5.6, 1.82), (10.9, 1.95)):
        ring = ring_points(centre, out, 0, 360, 28)
        drum(b, ring, foot, foot + 0.35, "stone", "turret.rings")
        for (x0, y0), (x1, y1), (u0, v0), (u1, v1) in zip(ring, ring[1:], body, body[1:], strict=False):
            top = foot + 0.35
            b.polygon([(x0, y0, top), (x1, y1, top), (u1, v1, top), (u0, v0, top)], "stone", "turret.rings")
            b.polygon([(x1, y1, foot), (x0, y0, foot), (u0, v0, foot), (u1, v1, foot)], "stone", "turret.rings")
    for t in np.radians([45.0, 135.0, 225.0, 315.0]):
        c, s = float(np.cos(t)), float(np.sin(t))
        axes = np.array([[-s, c, 0.0], [0.0, 0.0, 1.0], [c, s, 0.0]])
        b.bar(np.array([*centre, 8.6]) + 1.69 * axes[2], axes, (0.25, 0.7, 0.05), "glass", "turret.windows")
    eave = ring_points(centre, 2.05, 0, 360, 28)
    cone(b, eave, 11.5, (*centre, 16.4), "copper", "stone", "turret.roof")
    gutter(b, eave[:-1], 11.45, 0.1)
