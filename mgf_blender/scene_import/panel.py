# SPDX-License-Identifier: GPL-3.0-or-later
"""The Scene panel in the sidebar of the 3D viewport."""

from typing import ClassVar

import bpy

from ..common import runner
from ..common.job import Job
from ..common.panels import SidebarPanel
from ..common.text import tr
from ..engine.status_label import draw_engine_missing
from ..jobs.import_status import draw_waiting
from ..jobs.status_label import draw_job
from ..scene_keys import key_of
from .crop import find_crop_box
from .imported_scene import ImportedScene


class MGF_PT_scene(SidebarPanel, bpy.types.Panel):
    """Bring photos and cameras in"""

    bl_idname = "MGF_PT_scene"
    bl_label = "Scene"

    def draw(self, context: bpy.types.Context) -> None:
        layout, state = self.layout, context.scene.mgf
        imported = ImportedScene.find(context.scene)
        if imported is None:
            _draw_import(layout, context.scene)
            return
        row = layout.row(align=True)
        count = len(imported.objects("Cameras"))
        row.label(text=tr("{count} cameras", count=count), icon="CAMERA_DATA", translate=False)
        row.operator("mgf.look_through", text="", icon="TRIA_LEFT").step = -1
        row.operator("mgf.look_through", text="", icon="VIEW_CAMERA").step = 0
        row.operator("mgf.look_through", text="", icon="TRIA_RIGHT").step = 1
        row.prop(state, "fit_render", text="", icon="FULLSCREEN_ENTER")
        if find_crop_box(imported) is None:
            layout.operator("mgf.add_crop_box", icon="MESH_CUBE")
            return
        row = layout.row(align=True)
        row.operator("mgf.select_crop_box", text="Crop Box", icon="MESH_CUBE")
        row.operator("mgf.add_crop_box", text="", icon="FULLSCREEN_EXIT")
        row.operator("mgf.remove_crop_box", text="", icon="X")


def finding_cameras(scene: bpy.types.Scene) -> Job | None:
    """Return the job that finds the cameras of imported photos, while it runs and there are none yet."""
    return runner.live_job(key_of(scene), ("scene",)) if ImportedScene.find(scene) is None else None


def _draw_import(layout: bpy.types.UILayout, scene: bpy.types.Scene) -> None:
    """Draw an empty scene: how far the search for its cameras is, or the ways in and what stands in their way."""
    job = finding_cameras(scene)
    if job is not None:
        draw_job(layout, job)
        return
    column = layout.column()
    column.scale_y = 1.6
    column.operator("mgf.import_photos", icon="FILE_IMAGE")  # what most have, and all that is needed
    column = layout.column(align=True)
    column.operator("mgf.import_colmap", text="Import COLMAP Scene", icon="OUTLINER_OB_CAMERA")
    column.operator("mgf.import_result", icon="IMPORT")
    draw_waiting(layout, scene)
    draw_engine_missing(layout)


class _OfImportedScene(SidebarPanel):
    """Within the Scene panel, closed at first, once a scene is imported."""

    bl_parent_id = "MGF_PT_scene"
    bl_options: ClassVar = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return ImportedScene.find(context.scene) is not None


class MGF_PT_placement(_OfImportedScene, bpy.types.Panel):
    """Scale and orientation of the imported scene"""

    bl_idname = "MGF_PT_placement"
    bl_label = "Scale and Orientation"

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.operator("mgf.set_scale", icon="DRIVER_DISTANCE")
        layout.operator_menu_enum("mgf.set_up_axis", "axis", icon="ORIENTATION_GLOBAL")


class MGF_PT_source(_OfImportedScene, bpy.types.Panel):
    """Where the scene came from"""

    bl_idname = "MGF_PT_source"
    bl_label = "Source"

    def draw(self, context: bpy.types.Context) -> None:
        layout, state = self.layout, context.scene.mgf
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(state, "source", text="Scene")
        layout.prop(state, "photo_folder", text="Photos")
        layout.operator("mgf.reload_scene", icon="FILE_REFRESH")
        column = layout.column(align=True)
        column.operator("mgf.import_photos", text="Import Other Photos", icon="FILE_IMAGE")
        column.operator("mgf.import_colmap", text="Import Another Scene", icon="OUTLINER_OB_CAMERA")


CLASSES = (MGF_PT_scene, MGF_PT_placement, MGF_PT_source)


register, unregister = bpy.utils.register_classes_factory(CLASSES)
