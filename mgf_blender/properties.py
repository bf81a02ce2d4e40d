# SPDX-License-Identifier: GPL-3.0-or-later
"""Properties of a Blender scene, saved in the file: photos and clicks, options, job folder."""

import bpy

from .common import options
from .common.text import in_our_words
from .compat import PATH
from .drawings.properties import MGF_PG_drawings
from .georef.properties import MGF_PG_control_point, MGF_PG_georef, MGF_PG_mark
from .models.properties import MGF_PG_models
from .prompts.properties import BUILDING, MGF_PG_click, MGF_PG_photo, show_photo
from .scene_keys import scene_key

PARTS = [BUILDING, "window", "door", "roof", "wall", "balcony"]
OptionsGroup = options.make_group()
#: What is offered first to who limits the memory of jobs, GB.
MEMORY_LIMIT = 8.0


def _take_key(self: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    scene_key(self.id_data)  # drawing, which asks for previews, may not make one


def _limits_memory(self: bpy.types.PropertyGroup) -> bool:
    return self.options.memory > 0


def _limit_memory(self: bpy.types.PropertyGroup, limited: bool) -> None:
    self.options.memory = MEMORY_LIMIT if limited else 0.0


class MGF_PG_scene(bpy.types.PropertyGroup):
    """State of the add-on in one scene, at ``scene.mgf``."""

    key: bpy.props.StringProperty(options={"HIDDEN"}, description="Names this scene to running jobs")
    source: bpy.props.StringProperty(
        name="Source",
        description="COLMAP model, its project folder, or a folder of photos",
        subtype="DIR_PATH",
        options=PATH,
    )
    photo_folder: bpy.props.StringProperty(
        name="Photo Folder",
        description="Folder of the photos; searched near the model when empty",
        subtype="DIR_PATH",
        options=PATH,
    )
    masks_folder: bpy.props.StringProperty(
        name="Own Masks", description="Folder with your own masks, one PNG per photo; clicks are not needed then",
        subtype="DIR_PATH", options=PATH,
    )  # fmt: skip
    job_folder: bpy.props.StringProperty(
        name="Job Folder",
        description="Folder for working files and results; beside the .blend file when empty",
        subtype="DIR_PATH",
        options=PATH,
    )
    options: bpy.props.PointerProperty(type=OptionsGroup)
    limit_memory: bpy.props.BoolProperty(
        name="Limit Memory",
        description="Let a job use no more memory than this; three quarters of what is free where it is off",
        get=_limits_memory, set=_limit_memory,
    )  # fmt: skip
    drawings: bpy.props.PointerProperty(name="Drawings", type=MGF_PG_drawings)
    models: bpy.props.PointerProperty(name="Models", type=MGF_PG_models)
    georef: bpy.props.PointerProperty(name="Georeference", type=MGF_PG_georef)
    photos: bpy.props.CollectionProperty(type=MGF_PG_photo)
    photo_index: bpy.props.IntProperty(name="Photo", description="The photo to click on", update=show_photo)
    show_mask: bpy.props.BoolProperty(name="Show Mask", description="Draw the mask over the photo", default=True)
    mask_opacity: bpy.props.FloatProperty(
        name="Opacity", description="Opacity of the mask over the photo", default=0.45, min=0.0, max=1.0,
        subtype="FACTOR",
    )  # fmt: skip
    auto_preview: bpy.props.BoolProperty(
        name="Update After Each Click", description="Preview the mask again whenever the points of the photo change",
        default=False, update=_take_key,
    )  # fmt: skip
    part: bpy.props.StringProperty(
        name="Part", description="Part that new clicks mark: the building, or for example window or door",
        default=BUILDING, search=lambda self, context, text: PARTS,
    )  # fmt: skip
    suggest_at: bpy.props.EnumProperty(
        name="Building", description="Building to propose points for; where there is a crop box, the one in it",
        items=[
            ("LARGEST", "Largest Building", "The building with the largest area"),
            ("CURSOR", "At 3D Cursor", "The building at the 3D cursor; Shift right click in the viewport places it"),
        ],
    )  # fmt: skip
    fit_render: bpy.props.BoolProperty(
        name="Fit Render to Camera",
        description="Set render size and pixel aspect to those of the photo when the camera changes",
        default=True,
    )
    import_when_done: bpy.props.BoolProperty(
        name="Import When Done", description="Import the results when the job ends", default=True
    )
    figures: bpy.props.StringProperty(options={"HIDDEN"}, description="Figures of the imported job, as JSON")


CLASSES = (
    MGF_PG_click,
    MGF_PG_photo,
    OptionsGroup,
    MGF_PG_drawings,
    MGF_PG_models,
    MGF_PG_control_point,
    MGF_PG_mark,
    MGF_PG_georef,
    MGF_PG_scene,
)
in_our_words(*CLASSES)


def register() -> None:
    """Attach ``Scene.mgf``."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.Scene.mgf = bpy.props.PointerProperty(type=MGF_PG_scene)


def unregister() -> None:
    """Detach it again."""
    del bpy.types.Scene.mgf
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
