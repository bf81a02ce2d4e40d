# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of the models, as Blender properties."""

import bpy

KINDS = [
    ("lod", "Levels of Detail", "The mesh and three lighter ones, each with a texture of its own (GLB)"),
    ("tiles", "3D Tiles", "The levels of detail for globes and web maps"),
    ("solid", "Solid", "A closed block of walls, roof and ground for city models (CityJSON)"),
    ("ifc", "IFC", "The same solid for building models (IFC4)"),
    ("usd", "USD", "The levels of detail as variants, with textures (USDZ)"),
    ("points", "Points", "Points of the surface for comparison with laser scans (LAZ)"),
]


class MGF_PG_models(bpy.types.PropertyGroup):
    """Options of the next models, at ``scene.mgf.models``."""

    kinds: bpy.props.EnumProperty(
        name="Make", description="What to make; a new run takes the place of the one before", items=KINDS,
        options={"ENUM_FLAG"}, default={kind for kind, *_ in KINDS},
    )  # fmt: skip
    draco: bpy.props.BoolProperty(
        name="Compress", description="Compress the levels of detail with Draco, for the web; not every program opens "
        "such files", default=False,
    )  # fmt: skip
    detail: bpy.props.FloatProperty(
        name="Detail", description="Steps and offsets below this size are left out of the solid, in centimeters; "
        "0 takes 8 pixels of the photos", default=0.0, min=0.0, soft_max=200.0, precision=1,
    )  # fmt: skip
