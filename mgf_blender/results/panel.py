# SPDX-License-Identifier: GPL-3.0-or-later
"""The Results panel: import, what the cameras show, and the figures of the job."""

import json

import bpy

from ..common import options
from ..scene_import.cameras import PHOTO_KEY, SHOWN_KEY
from ..scene_import.tree import Tree
from . import switch


class MGF_PT_results(bpy.types.Panel):
    """Mesh, renders and figures of the job"""

    bl_idname = "MGF_PT_results"
    bl_label = "Results"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "MGF"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return Tree.find(context.scene) is not None

    def draw(self, context: bpy.types.Context) -> None:
        layout, scene = self.layout, context.scene
        tree = Tree.find(scene)
        meshes = tree.objects("Mesh")
        row = layout.row(align=True)
        row.operator("mgf.import_result", icon="IMPORT")
        row.operator("mgf.open_job_file", text="", icon="URL").name = "report.html"
        if not meshes:
            return
        layout.operator("mgf.import_field", icon="OUTLINER_OB_POINTCLOUD")
        for obj in meshes:
            layout.label(text=f"{obj.name}: {len(obj.data.polygons):,} faces", icon="MESH_DATA", translate=False)
        camera = scene.camera
        if camera is not None and PHOTO_KEY in camera:
            column = layout.column(align=True)
            column.label(text=camera.name, icon="CAMERA_DATA", translate=False)
            row = column.row(align=True)
            there = switch.available(camera)
            for kind in switch.KINDS:
                cell = row.row(align=True)
                cell.enabled = kind in there
                cell.operator(
                    "mgf.show_in_camera", text=kind.capitalize(), depress=kind == camera.get(SHOWN_KEY)
                ).kind = kind
        _draw_figures(layout, scene.mgf.figures)


def _draw_figures(layout: bpy.types.UILayout, text: str) -> None:
    try:
        figures = json.loads(text) if text else {}
    except ValueError:
        figures = {}
    if not figures:
        return
    column = layout.box().column(align=True)
    for name, value in figures.items():
        if isinstance(value, int | float | str):
            row = column.row()
            row.label(text=options.title(str(name)))
            row.label(text=f"{value:.4g}" if isinstance(value, float) else str(value), translate=False)


def register() -> None:
    """Register the panel."""
    bpy.utils.register_class(MGF_PT_results)


def unregister() -> None:
    """Take it away."""
    bpy.utils.unregister_class(MGF_PT_results)
