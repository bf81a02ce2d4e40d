# SPDX-License-Identifier: GPL-3.0-or-later
"""The Results panel: import, what the cameras show, and the figures of the job."""

import json

import bpy

from ..common.panels import SidebarPanel
from ..common.stats import draw_figures
from ..common.text import N_, draw_sentence, tr
from ..job_folder import has_job_file, job_folder
from ..jobs.import_status import draw_waiting
from ..scene_import.cameras import PHOTO_KEY, SHOWN_KEY
from ..scene_import.imported_scene import ImportedScene, is_shown
from . import surface, view_mode
from .runs import old_runs

_PAINTS = {"TEXTURE": N_("Texture"), "COLOR": N_("Colors"), "CONFIDENCE": N_("Confidence"), "VIEWS": N_("Views")}
_SHOWS = {"PHOTO": N_("Photo"), "RENDER": N_("Render"), "ERROR": N_("Error"), "MESH": N_("Mesh")}


class MGF_PT_results(SidebarPanel, bpy.types.Panel):
    """Mesh, renders and figures of the job"""

    bl_idname = "MGF_PT_results"
    bl_label = "Results"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return ImportedScene.find(context.scene) is not None

    def draw(self, context: bpy.types.Context) -> None:
        layout, scene = self.layout, context.scene
        imported = ImportedScene.find(scene)
        meshes = imported.objects("Mesh")
        row = layout.row(align=True)
        row.operator("mgf.import_result", icon="IMPORT")
        if has_job_file(scene, "report.html"):
            row.operator("mgf.open_job_file", text="", icon="URL").name = "report.html"
        if has_job_file(scene, "runs") and old_runs(job_folder(scene)):
            row.operator("mgf.remove_old_runs", text="", icon="TRASH")
        draw_waiting(layout, scene)
        if not meshes:
            return
        row = layout.row(align=True)
        row.operator("mgf.import_field", icon="OUTLINER_OB_POINTCLOUD")
        row.operator("mgf.export_field", text="", icon="EXPORT")
        for obj in meshes:
            _draw_mesh(layout, obj)
        if scene.camera is not None and PHOTO_KEY in scene.camera:
            _draw_camera(layout, imported, scene.camera, getattr(context.space_data, "region_3d", None))
        _draw_figures(layout, scene.mgf.figures)


def _draw_mesh(layout: bpy.types.UILayout, obj: bpy.types.Object) -> None:
    """Draw a mesh, and what it is painted with."""
    column = layout.column(align=True)
    text = tr("{name}: {count:,} faces", name=obj.name, count=len(obj.data.polygons))
    draw_sentence(column, text, "MESH_DATA")
    kinds, now = surface.available(obj.data), surface.shown(obj.data) if is_shown(obj) else ""
    if len(kinds) < 2:
        return
    grid = column.grid_flow(columns=2, row_major=True, even_columns=True, align=True)  # in one row words are cut off
    for kind in kinds:
        grid.operator("mgf.paint_mesh", text=_PAINTS[kind], depress=kind == now).kind = kind
    if now in {"CONFIDENCE", "VIEWS"}:
        draw_sentence(column, surface.scale_text(obj.data, now), "NONE")


def _draw_camera(
    layout: bpy.types.UILayout,
    imported: ImportedScene,
    camera: bpy.types.Object,
    view: bpy.types.RegionView3D | None,
) -> None:
    """Draw the active camera, what it shows, and how a mesh that it hides comes back when the view has left it."""
    column = layout.column(align=True)
    column.label(text=camera.name, icon="CAMERA_DATA", translate=False)
    row = column.row(align=True)
    there, shown = view_mode.available(camera), camera.get(SHOWN_KEY, "MESH")
    for kind in view_mode.KINDS:
        cell = row.row(align=True)
        cell.enabled = kind in there
        cell.operator("mgf.show_in_camera", text=_SHOWS[kind], depress=kind == shown).kind = kind
    if shown != "MESH" and view is not None and view.view_perspective != "CAMERA":
        draw_sentence(column, tr("The mesh is hidden; press Mesh to see it"), "HIDE_ON")
    elif shown == "ERROR":
        draw_sentence(column, tr("Dark: alike, bright: different"), "NONE")
    elif not imported.objects("Renders"):
        draw_sentence(column, tr("Without training, as with the preset Quick, there are no renders"), "INFO")
    elif "RENDER" not in there:
        draw_sentence(column, tr("No render of this photo; the option Render All makes one"), "INFO")


def _draw_figures(layout: bpy.types.UILayout, text: str) -> None:
    try:
        figures = json.loads(text) if text else {}
    except ValueError:
        figures = {}
    if figures:
        draw_figures(layout.box().column(align=True), figures)


register, unregister = bpy.utils.register_classes_factory((MGF_PT_results,))
