# SPDX-License-Identifier: GPL-3.0-or-later
"""Roofs and what goes around a building: gable, hip, lean-to, cone, gutters, bands, curved walls."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from benchmarks.shapes import Builder

Corner = tuple[float, float]
#: How thick roofs are, and how far their top lies above the plane through the tops of the walls.
_THICK, _LIFT = 0.2, 0.22


def band(
    b: Builder, x: float, y: float, out: tuple[float, float], z: tuple[float, float], material: str, element: str
) -> None:
    """Four boxes around a rectangle of half sizes x, y, from ``out[0]`` to ``out[1]`` off its sides."""
    i, o = out
    for s in (-1, 1):
        low, high = sorted((s * (y + i), s * (y + o)))
        b.box((-x - o, low, z[0]), (x + o, high, z[1]), material, element)
        low, high = sorted((s * (x + i), s * (x + o)))
        b.box((low, -y - i, z[0]), (high, y + i, z[1]), material, element)


def gable_roof(
    b: Builder, x: float, y: float, eaves: float, ridge: float, over: float, material: str = "tiles"
) -> None:
    """Two slopes over a rectangle of half sizes x, y; the ridge runs along x."""
    slope = (ridge - eaves) / y
    low = eaves - slope * over
    for side, sign in (("south", -1.0), ("north", 1.0)):
        quad = [(-x - over, sign * (y + over), low + _LIFT), (x + over, sign * (y + over), low + _LIFT),
                (x + over, 0.0, ridge + _LIFT), (-x - over, 0.0, ridge + _LIFT)]  # fmt: skip
        b.roof_slab(quad if sign < 0 else quad[::-1], _THICK, material, "wood_trim", f"roof.{side}")
    cap = "ridge_tiles" if material == "tiles" else material
    b.beam((-x - over, 0, ridge + 0.24), (x + over, 0, ridge + 0.24), 0.22, cap, "roof.ridge")


def hip_roof(
    b: Builder, low: Corner, high: Corner, eaves: float, ridge: float, over: float, material: str, edge: str
) -> None:
    """Four slopes of one pitch over a rectangle that is longer along x, with gutters along its eaves."""
    (x0, y0), (x1, y1) = low, high
    half, middle = (y1 - y0) / 2, (y0 + y1) / 2
    foot = eaves - (ridge - eaves) / half * over + _LIFT
    a, c, d, e = (
        (x0 - over, y0 - over, foot), (x1 + over, y0 - over, foot), (x1 + over, y1 + over, foot),
        (x0 - over, y1 + over, foot),
    )  # fmt: skip
    west, east = (x0 + half, middle, ridge + _LIFT), (x1 - half, middle, ridge + _LIFT)
    for name, polygon in (("south", [a, c, east, west]), ("east", [c, d, east]), ("north", [d, e, west, east]),
                          ("west", [e, a, west])):  # fmt: skip
        b.roof_slab(polygon, _THICK, material, edge, f"roof.{name}")
    corners = [(x0 - over, y0 - over), (x1 + over, y0 - over), (x1 + over, y1 + over), (x0 - over, y1 + over)]
    gutter(b, corners, foot - 0.1)


def gutter(b: Builder, corners: list[Corner], height: float, width: float = 0.12) -> None:
    """A metal gutter around a closed outline on the ground, at a height."""
    for (x0, y0), (x1, y1) in zip(corners, corners[1:] + corners[:1], strict=True):
        b.beam((x0, y0, height), (x1, y1, height), width, "metal", "gutter")


def lean_to(b: Builder, low: Corner, high: Corner, eaves: float, top: float, over: float, material: str) -> None:
    """One slope over a rectangle that rises from its east side to the wall at its west side."""
    (x0, y0), (x1, y1) = low, high
    foot = eaves - (top - eaves) / (x1 - x0) * over + _LIFT
    quad = [(x1 + over, y0 - over, foot), (x1 + over, y1 + over, foot), (x0, y1 + over, top + _LIFT),
            (x0, y0 - over, top + _LIFT)]  # fmt: skip
    b.roof_slab(quad, _THICK, material, "wood_trim", "roof.annex")
    b.beam((x1 + over, y0 - over, foot - 0.1), (x1 + over, y1 + over, foot - 0.1), 0.12, "metal", "gutter")


def ring_points(centre: Corner, radius: float, start: float, end: float, count: int) -> list[Corner]:
    """Return points on an arc, counter-clockwise from ``start`` to ``end`` in degrees, both included."""
    angles = np.radians(np.linspace(start, end, count + 1))
    return [(centre[0] + radius * float(np.cos(t)), centre[1] + radius * float(np.sin(t))) for t in angles]


def drum(b: Builder, arc: list[Corner], foot: float, top: float, material: str, element: str) -> None:
    """An upright curved wall along an arc that runs counter-clockwise seen from above."""
    for (x0, y0), (x1, y1) in pairwise(arc):
        b.polygon([(x0, y0, foot), (x1, y1, foot), (x1, y1, top), (x0, y0, top)], material, element)


def cone(b: Builder, arc: list[Corner], foot: float, apex: tuple[float, float, float], material: str, edge: str,
         element: str) -> None:  # fmt: skip
    """A pointed roof over an arc, closed below."""
    for (x0, y0), (x1, y1) in pairwise(arc):
        b.polygon([(x0, y0, foot), (x1, y1, foot), apex], material, element)
        b.polygon([(x1, y1, foot), (x0, y0, foot), (apex[0], apex[1], foot)], edge, "")
