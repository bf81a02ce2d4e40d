# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of the drawings, as Blender properties."""

import bpy

KINDS = [
    ("orthophotos", "Orthophotos", "Facades and the building from above, painted from the photos (PNG, GeoTIFF)"),
    ("elevations", "Elevations", "Facades and roof as lines, what is hidden left out (DXF, SVG)"),
    ("sections", "Sections", "Where planes cut the building, hatched (DXF, SVG)"),
    ("sheets", "Sheets", "Orthophotos and lines for printing, with scale bar and title (PDF, SVG)"),
    ("quantities", "Quantities", "Areas, heights, volume, and how even and upright the walls are (CSV, pictures)"),
]


class MGF_PG_drawings(bpy.types.PropertyGroup):
    """Options of the next drawings, at ``scene.mgf.drawings``."""

    kinds: bpy.props.EnumProperty(
        name="Draw", description="What to draw; a new run takes the place of the one before", items=KINDS,
        options={"ENUM_FLAG"}, default={kind for kind, *_ in KINDS},
    )  # fmt: skip
    resolution: bpy.props.FloatProperty(
        name="Pixel Size", description="Millimeters per pixel of the orthophotos; 0 takes what the photos have",
        default=0.0, min=0.0, soft_max=100.0, precision=2,
    )  # fmt: skip
    paper: bpy.props.EnumProperty(
        name="Paper Size", description="Size of the sheets",
        items=[("A3", "A3", "420 × 297 mm"), ("A1", "A1", "841 × 594 mm")], default="A3",
    )  # fmt: skip
    scale: bpy.props.IntProperty(
        name="Scale 1 To", description="Scale of the sheets; 0 takes the largest round one that fits", default=0, min=0,
        soft_max=1000,
    )  # fmt: skip
    height: bpy.props.FloatProperty(
        name="Cut at Height", description="Height of a level section above the lowest point, in meters where the job "
        "has true coordinates; 0 is none", default=0.0, min=0.0, soft_max=50.0, precision=3,
    )  # fmt: skip
