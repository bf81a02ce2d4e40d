# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the Town panel."""

from pathlib import Path

import bpy
import numpy as np

from ..common.errors import UserError
from ..common.operators import FileOperator, Operator
from ..common.selection import selected_objects
from ..common.text import tr
from ..common.views import frame_scene
from ..scene_import.imported_scene import is_own, objects_below
from .files import read_town
from .load import BUILDING_KEY, JOB_KEY, LIGHT_KEY, find_town, import_steps, show_full, show_light


class MGF_OT_import_town(FileOperator):
    """Import what mgf town made: a collection for each building, with few faces at first, and the terrain"""

    bl_idname = "mgf.import_town"
    bl_label = "Import Town"
    bl_options = {"REGISTER", "UNDO"}

    directory: bpy.props.StringProperty(subtype="DIR_PATH", options={"SKIP_SAVE"})
    filter_folder: bpy.props.BoolProperty(default=True, options={"HIDDEN"})

    def run(self, context: bpy.types.Context) -> None:
        if not self.directory:
            raise UserError("No folder was chosen; choose the folder that mgf town made.")
        town = read_town(Path(bpy.path.abspath(self.directory)).absolute())
        manager = context.window_manager
        manager.progress_begin(0.0, 1.0)
        try:
            for share in import_steps(context.scene, town):
                manager.progress_update(share)
        finally:
            manager.progress_end()
        frame_town(context, find_town(context.scene, town.folder))
        text = tr("{count} buildings imported, {missing} are not done", count=len(town.buildings), missing=town.missing)
        self.report({"INFO"}, text)


class _OnBuildings(Operator):
    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return cls.needs(chosen_buildings(context), "Select buildings of a town first")


class MGF_OT_show_full_building(_OnBuildings):
    """Load the full mesh of the selected buildings, with its texture"""

    bl_idname = "mgf.show_full_building"
    bl_label = "Show Full Mesh"
    bl_options = {"REGISTER", "UNDO"}

    def run(self, context: bpy.types.Context) -> None:
        chosen, problems = chosen_buildings(context), list[UserError]()
        for obj in chosen:
            try:
                show_full(obj)
            except UserError as error:  # the others can be shown all the same
                problems.append(error)
        if len(problems) == len(chosen):
            raise problems[0]
        for problem in problems:
            self.report({"WARNING"}, str(problem))


class MGF_OT_show_light_building(_OnBuildings):
    """Go back to the simplified mesh of the selected buildings"""

    bl_idname = "mgf.show_light_building"
    bl_label = "Show Simplified Mesh"
    bl_options = {"REGISTER", "UNDO"}

    def run(self, context: bpy.types.Context) -> None:
        for obj in chosen_buildings(context):
            show_light(obj)


def chosen_buildings(context: bpy.types.Context) -> list[bpy.types.Object]:
    """Return the selected objects that are buildings of a town of this file."""
    return [obj for obj in selected_objects(context) if JOB_KEY in obj and obj.type == "MESH" and is_own(obj)]


def is_full(obj: bpy.types.Object) -> bool:
    """Tell whether a building shows its full mesh."""
    return obj.get(LIGHT_KEY) is not None


def frame_town(context: bpy.types.Context, top: bpy.types.Collection) -> None:
    """Turn the viewports to a town."""
    objects = [obj for obj in objects_below(top) if BUILDING_KEY in obj]
    corners = np.concatenate([np.array(obj.bound_box) for obj in objects])
    low, high = corners.min(0), corners.max(0)
    # In the vertices' colours: the solid mode draws what has no texture grey where it draws textures.
    frame_scene(context, (low + high) / 2, float(np.linalg.norm(high - low)) / 2)


def menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Draw the entry of File > Import."""
    self.layout.operator(MGF_OT_import_town.bl_idname, text="MGF Town")


CLASSES = (MGF_OT_import_town, MGF_OT_show_full_building, MGF_OT_show_light_building)


def register() -> None:
    """Register the operators and the menu entry."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.TOPBAR_MT_file_import.append(menu)


def unregister() -> None:
    """Take them away again."""
    bpy.types.TOPBAR_MT_file_import.remove(menu)
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
