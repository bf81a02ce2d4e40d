# SPDX-License-Identifier: GPL-3.0-or-later
"""Procedural materials of the synthetic scenes, in metres: UV lies in the plane of each face.

Run inside Blender only. Every material is a few layers of colour with a bump; ``strength`` scales how far the
colours of the layers lie from their mean, so a scene can go from rich to nearly plain texture.
"""

from __future__ import annotations

from collections.abc import Callable

import bpy
from layers import Color, Layers


def _brick(s: float) -> bpy.types.Material:
    m = Layers("brick", s).bricks(
        (0.46, 0.155, 0.085), (0.20, 0.06, 0.04), (0.42, 0.38, 0.33), 0.25, 0.083, 0.008, 0.012
    )
    m.stains((0.5, 0.5, 0.54), (1.2, 1.15, 1.05), 0.55, 0.9).stains((0.45, 0.44, 0.42), (1.2, 1.2, 1.15), 1.7, 0.8)
    m.stains((1.0, 1.0, 1.0), (1.9, 1.9, 1.95), 2.6, 0.8, 0.6, 0.7)  # lime bloom
    return m.stains((0.5, 0.48, 0.46), (1.2, 1.2, 1.2), 5.0, 0.8, stretch=(1, 1, 0.6)).rough(18.0, 0.004).done()


def _plaster(s: float) -> bpy.types.Material:
    m = Layers("plaster", s).plain((0.70, 0.66, 0.57)).stains((0.78, 0.77, 0.75), (1.05, 1.04, 1.02), 0.5, 0.9)
    m.stains((0.62, 0.60, 0.56), (1.06, 1.06, 1.06), 2.4, 0.8, stretch=(1, 1, 0.4))
    return m.stains((0.7, 0.7, 0.7), (1.1, 1.1, 1.1), 7.0, 0.7).rough(40.0, 0.004).done()


def _white(s: float) -> bpy.types.Material:
    m = Layers("white", s).plain((0.80, 0.80, 0.78)).stains((0.93, 0.93, 0.92), (1.02, 1.02, 1.02), 0.4, 0.6)
    return m.rough(60.0, 0.001).done()


def _tiles(s: float) -> bpy.types.Material:
    m = Layers("tiles", s, 0.75).bricks(
        (0.42, 0.13, 0.07), (0.22, 0.07, 0.045), (0.06, 0.025, 0.02), 0.28, 0.36, 0.014, 0.03
    )
    m.waves(1.122, 0.03).stains((0.5, 0.54, 0.5), (1.25, 1.18, 1.1), 0.6, 0.9).stains(
        (0.45, 0.5, 0.42), (1.2, 1.15, 1.1), 1.8, 0.85
    )
    m.stains((1.0, 1.0, 1.0), (1.1, 1.7, 1.2), 1.1, 0.7, 0.58, 0.7)  # moss
    return m.stains((0.5, 0.5, 0.48), (1.2, 1.2, 1.2), 4.5, 0.8).done()


def _slate(s: float) -> bpy.types.Material:
    m = Layers("slate", s, 0.6).bricks(
        (0.12, 0.13, 0.15), (0.065, 0.07, 0.085), (0.02, 0.02, 0.025), 0.22, 0.2, 0.008, 0.012
    )
    return m.stains((0.7, 0.72, 0.7), (1.25, 1.22, 1.2), 1.6, 0.8).done(specular=0.4)


def _stone(s: float) -> bpy.types.Material:
    m = Layers("stone", s).bricks((0.50, 0.43, 0.32), (0.40, 0.34, 0.25), (0.26, 0.23, 0.18), 0.7, 0.35, 0.01, 0.01)
    return m.stains((0.68, 0.66, 0.62), (1.1, 1.1, 1.1), 3.0, 0.8).rough(25.0, 0.006).done()


def _glass(s: float) -> bpy.types.Material:
    m = Layers("glass", s, 0.06).plain((0.045, 0.055, 0.065)).stains((0.5, 0.5, 0.5), (1.6, 1.5, 1.3), 0.9, 0.9)
    m.stains((1.0, 1.0, 1.0), (6.0, 5.6, 5.0), 0.45, 0.9, 0.5, 0.6)  # curtains here and there
    return m.done(specular=0.9)


def _ground(
    name: str, color: Color, scales: tuple[float, ...], rough: float, spread: float
) -> Callable[[float], bpy.types.Material]:
    def make(s: float) -> bpy.types.Material:
        m = Layers(name, s).plain(color)
        for scale in scales:
            m.stains(
                (1 - spread, 1 - spread * 0.9, 1 - spread),
                (1 + spread * 0.5, 1 + spread * 0.4, 1 + spread * 0.3),
                scale,
                0.8,
            )
        return m.rough(30.0, rough).done()

    return make


def _paving(s: float) -> bpy.types.Material:
    m = Layers("paving", s).bricks((0.36, 0.34, 0.31), (0.22, 0.21, 0.2), (0.12, 0.12, 0.11), 0.6, 0.4, 0.015, 0.01)
    return (
        m.stains((0.6, 0.6, 0.6), (1.15, 1.15, 1.15), 1.2, 0.8)
        .stains((0.6, 0.6, 0.6), (1.15, 1.15, 1.15), 4.0, 0.8)
        .done()
    )


def _sheet(s: float) -> bpy.types.Material:
    m = Layers("sheet", s, 0.45).bricks(
        (0.34, 0.37, 0.38), (0.25, 0.28, 0.29), (0.12, 0.13, 0.13), 0.6, 3.0, 0.02, 0.02
    )
    return (
        m.stains((0.62, 0.6, 0.57), (1.15, 1.13, 1.1), 0.8, 0.8)
        .stains((0.8, 0.75, 0.7), (1.1, 1.1, 1.1), 5.0, 0.6)
        .done(0.3)
    )


def _steel(s: float) -> bpy.types.Material:
    m = Layers("steel", s, 0.6).plain((0.20, 0.24, 0.22)).stains((0.7, 0.45, 0.35), (1.2, 1.2, 1.2), 3.0, 0.85)
    return m.stains((0.7, 0.7, 0.7), (1.15, 1.15, 1.15), 9.0, 0.7).done(0.1)


def _ashlar(s: float) -> bpy.types.Material:
    m = Layers("ashlar", s).bricks((0.40, 0.36, 0.30), (0.27, 0.25, 0.22), (0.33, 0.31, 0.28), 0.85, 0.42, 0.012, 0.015)
    m.stains((0.62, 0.6, 0.56), (1.15, 1.14, 1.1), 1.3, 0.8)
    return m.stains((0.7, 0.69, 0.66), (1.1, 1.1, 1.1), 5.0, 0.8).rough(22.0, 0.01).done()


def _sandstone(s: float) -> bpy.types.Material:
    m = Layers("sandstone", s)
    m.bricks((0.52, 0.36, 0.22), (0.44, 0.30, 0.19), (0.36, 0.26, 0.18), 0.6, 0.3, 0.008, 0.008)
    m.stains((0.6, 0.58, 0.56), (1.1, 1.08, 1.05), 0.7, 0.85, stretch=(1, 1, 0.5))
    return m.stains((0.75, 0.74, 0.72), (1.08, 1.08, 1.08), 4.0, 0.7).rough(25.0, 0.004).done()


def _clay(s: float) -> bpy.types.Material:
    m = Layers("clay", s).plain((0.72, 0.66, 0.52)).stains((0.85, 0.84, 0.82), (1.04, 1.04, 1.03), 0.8, 0.7)
    return m.rough(30.0, 0.003).done()


def _timber(s: float) -> bpy.types.Material:
    m = Layers("timber", s, 0.8).plain((0.085, 0.05, 0.03))
    return m.stains((0.55, 0.55, 0.55), (1.3, 1.25, 1.2), 3.0, 0.9, stretch=(4, 4, 1)).rough(20.0, 0.004).done()


def _cladding(s: float) -> bpy.types.Material:
    m = Layers("cladding", s, 0.8)
    m.bricks((0.30, 0.17, 0.09), (0.23, 0.13, 0.07), (0.07, 0.04, 0.03), 4.0, 0.16, 0.008, 0.02)
    return m.stains((0.7, 0.68, 0.66), (1.15, 1.12, 1.1), 1.0, 0.8, stretch=(0.3, 0.3, 3)).rough(25.0, 0.003).done()


def _dark_metal(s: float) -> bpy.types.Material:
    """Sheets with standing seams half a metre apart, dull and dark."""
    m = Layers("dark_metal", s, 0.4).bricks(
        (0.055, 0.06, 0.065), (0.05, 0.055, 0.06), (0.02, 0.022, 0.025), 0.5, 40.0, 0.015, 0.03
    )
    return m.stains((0.85, 0.85, 0.85), (1.1, 1.1, 1.1), 0.8, 0.7).done(0.7, 0.5)


def _shiny_sheet(s: float) -> bpy.types.Material:
    """Corrugated bright metal: mirrors sky and ground, broken by its ribs."""
    m = Layers("shiny_sheet", s, 0.18).plain((0.62, 0.64, 0.66))
    m.stains((0.93, 0.93, 0.93), (1.03, 1.03, 1.03), 0.5, 0.7)
    return m.waves(1.6, 0.02).done(0.95, 0.5)


def _raw_concrete(s: float) -> bpy.types.Material:
    """Boarded panels with joints and runs of dirt."""
    m = Layers("raw_concrete", s)
    m.bricks((0.36, 0.35, 0.33), (0.33, 0.325, 0.31), (0.22, 0.21, 0.2), 2.4, 1.2, 0.012, 0.008)
    m.stains((0.72, 0.7, 0.67), (1.08, 1.08, 1.07), 0.6, 0.8, stretch=(1.5, 1.5, 0.25))
    return m.stains((0.82, 0.82, 0.8), (1.05, 1.05, 1.05), 3.0, 0.6).rough(30.0, 0.002).done()


def _shingles(s: float) -> bpy.types.Material:
    """Shingles all alike, as fine as a pixel of a flight high above: their pattern differs from photo to photo."""
    m = Layers("shingles", s, 0.85)
    return m.bricks((0.24, 0.22, 0.20), (0.24, 0.22, 0.20), (0.05, 0.045, 0.04), 0.16, 0.14, 0.03, 0.01).done()


def _even(
    name: str, color: Color, roughness: float, metallic: float = 0.0, patches: float = 4.0, specular: float = 0.4
) -> Callable[[float], bpy.types.Material]:
    def make(s: float) -> bpy.types.Material:
        m = Layers(name, s, roughness).plain(color).stains((0.65, 0.65, 0.65), (1.15, 1.15, 1.15), patches, 0.8)
        return m.done(metallic, specular)

    return make


def _clean(
    name: str, color: Color, roughness: float = 0.9, metallic: float = 0.0, specular: float = 0.3
) -> Callable[[float], bpy.types.Material]:
    """One colour and nothing else: no stain, no grain, no bump."""

    def make(s: float) -> bpy.types.Material:
        return Layers(name, s, roughness).plain(color).done(metallic, specular)

    return make


MATERIALS: dict[str, Callable[[float], bpy.types.Material]] = {
    "brick": _brick,
    "plaster": _plaster,
    "white": _white,
    "clean_white": _clean("clean_white", (0.86, 0.86, 0.84)),
    "clean_red": _clean("clean_red", (0.30, 0.075, 0.045), 0.8),
    "clean_ochre": _clean("clean_ochre", (0.72, 0.50, 0.20)),
    "clean_grey": _clean("clean_grey", (0.075, 0.08, 0.085), 0.7),
    "mirror_glass": _clean("mirror_glass", (0.42, 0.50, 0.54), 0.02, 0.9, 0.8),
    "spandrel": _clean("spandrel", (0.03, 0.05, 0.06), 0.08, 0.0, 0.8),
    "alu": _clean("alu", (0.55, 0.56, 0.57), 0.35, 0.8),
    "ashlar": _ashlar,
    "sandstone": _sandstone,
    "clay": _clay,
    "timber": _timber,
    "cladding": _cladding,
    "felt": _ground("felt", (0.10, 0.095, 0.09), (0.5, 3.0, 12.0), 0.01, 0.35),
    "dark_metal": _dark_metal,
    "shiny_sheet": _shiny_sheet,
    "raw_concrete": _raw_concrete,
    "shingles": _shingles,
    "tiles": _tiles,
    "ridge_tiles": _even("ridge_tiles", (0.27, 0.09, 0.055), 0.8),
    "slate": _slate,
    "stone": _stone,
    "glass": _glass,
    "sheet": _sheet,
    "steel": _steel,
    "paving": _paving,
    "grass": _ground("grass", (0.115, 0.16, 0.05), (0.09, 0.5, 1.4, 3.5, 9.0), 0.05, 0.75),
    "asphalt": _ground("asphalt", (0.075, 0.075, 0.08), (0.3, 2.0, 9.0), 0.01, 0.35),
    "gravel": _ground("gravel", (0.33, 0.31, 0.28), (0.4, 2.5, 9.0), 0.02, 0.4),
    "concrete": _ground("concrete", (0.42, 0.41, 0.39), (0.7, 4.0), 0.005, 0.3),
    "wood": _even("wood", (0.14, 0.07, 0.035), 0.6, patches=6.0),
    "wood_trim": _even("wood_trim", (0.42, 0.38, 0.32), 0.7, patches=5.0),
    "frame": _even("frame", (0.72, 0.71, 0.68), 0.5),
    "metal": _even("metal", (0.40, 0.41, 0.42), 0.45, 0.5),
    "metal_door": _even("metal_door", (0.16, 0.22, 0.27), 0.5),
    "copper": _even("copper", (0.22, 0.40, 0.33), 0.6, patches=2.0),
    "bark": _even("bark", (0.10, 0.07, 0.045), 0.95, patches=5.0),
    "leaves": _even("leaves", (0.075, 0.17, 0.03), 0.7, patches=1.5, specular=0.2),
    "paint": _even("paint", (0.7, 0.7, 0.68), 0.8),
    "rubber": _even("rubber", (0.02, 0.02, 0.02), 0.8),
    "car_red": _even("car_red", (0.35, 0.03, 0.03), 0.25, specular=0.6),
    "car_white": _even("car_white", (0.7, 0.7, 0.7), 0.25, specular=0.6),
    "car_blue": _even("car_blue", (0.04, 0.08, 0.25), 0.25, specular=0.6),
    "car_grey": _even("car_grey", (0.18, 0.19, 0.2), 0.25, 0.3, specular=0.6),
}
