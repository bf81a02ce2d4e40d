# SPDX-License-Identifier: GPL-3.0-or-later
"""The Scene panel in the sidebar of the 3D viewport."""

import bpy

from .crop import find_crop_box
from .tree import Tree


class MGF_PT_scene(bpy.types.Panel):
    """Bring photos and cameras in"""

    bl_idname = "MGF_PT_scene"
    bl_label = "Scene"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "MGF"

    def draw(self, context: bpy.types.Context) -> None:
        layout, state = self.layout, context.scene.mgf
        tree = Tree.find(context.scene)
        column = layout.column(align=tree is not None)
        column.scale_y = 1.4 if tree is None else 1.0
        column.operator("mgf.import_colmap", icon="OUTLINER_OB_CAMERA")
        column.operator("mgf.import_photos", icon="FILE_IMAGE")
        if tree is None:
            column.operator("mgf.import_result", icon="IMPORT")
            return
        row = layout.row(align=True)
        row.label(text=f"{len(tree.objects('Cameras'))} cameras", icon="CAMERA_DATA")
        row.operator("mgf.look_through", text="", icon="TRIA_LEFT").step = -1
        row.operator("mgf.look_through", text="", icon="VIEW_CAMERA").step = 0
        row.operator("mgf.look_through", text="", icon="TRIA_RIGHT").step = 1
        layout.prop(state, "fit_render")
        if find_crop_box(tree) is None:
            layout.operator("mgf.add_crop_box", icon="MESH_CUBE")
            return
        row = layout.row(align=True)
        row.operator("mgf.select_crop_box", text="Crop Box", icon="MESH_CUBE")
        row.operator("mgf.add_crop_box", text="", icon="FULLSCREEN_EXIT")
        row.operator("mgf.remove_crop_box", text="", icon="X")


class MGF_PT_placement(bpy.types.Panel):
    """Scale and orientation of the imported scene"""

    bl_idname = "MGF_PT_placement"
    bl_label = "Scale and Orientation"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "MGF"
    bl_parent_id = "MGF_PT_scene"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return Tree.find(context.scene) is not None

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.operator("mgf.set_scale", icon="DRIVER_DISTANCE")
        layout.operator_menu_enum("mgf.set_up_axis", "axis", icon="ORIENTATION_GLOBAL")


class MGF_PT_source(bpy.types.Panel):
    """Where the scene came from"""

    bl_idname = "MGF_PT_source"
    bl_label = "Source"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "MGF"
    bl_parent_id = "MGF_PT_scene"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return Tree.find(context.scene) is not None

    def draw(self, context: bpy.types.Context) -> None:
        layout, state = self.layout, context.scene.mgf
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(state, "source", text="Scene")
        layout.prop(state, "photo_folder", text="Photos")
        layout.operator("mgf.reload_scene", icon="FILE_REFRESH")


CLASSES = (MGF_PT_scene, MGF_PT_placement, MGF_PT_source)


def register() -> None:
    """Register the panels."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Take them away."""
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
