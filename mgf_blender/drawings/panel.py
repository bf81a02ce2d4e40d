# SPDX-License-Identifier: GPL-3.0-or-later
"""The Drawings panel: what to draw, where to cut, progress, and buttons for what came."""

import bpy

from ..common.text import draw_sentence, tr
from ..engine.status_label import draw_engine_missing
from ..job_folder import job_folder
from ..jobs.finished_job import FinishedJobPanel, draw_run
from .index import FOLDER, PAGE, read_index
from .previews import preview_icon
from .sections import find_sections

_PREVIEW = 5.0  # height of a picture in the panel, buttons


class MGF_PT_drawings(FinishedJobPanel, bpy.types.Panel):
    """Orthophotos, elevations, sections and quantities of the finished job"""

    bl_idname = "MGF_PT_drawings"
    bl_label = "Drawings"

    def draw(self, context: bpy.types.Context) -> None:
        layout, scene = self.layout, context.scene
        wanted = scene.mgf.drawings
        layout.use_property_split = True
        layout.use_property_decorate = False
        column = layout.column()
        column.prop(wanted, "kinds")
        if wanted.kinds & {"orthophotos", "sheets", "quantities"}:
            column.prop(wanted, "resolution", text="Pixel (mm)")
        if "sheets" in wanted.kinds:
            column.prop(wanted, "paper")
            column.prop(wanted, "scale")
        if _chosen_by_itself(wanted):
            draw_sentence(column, tr("0: chosen automatically"), "INFO")
        if "sections" in wanted.kinds:
            _draw_sections(layout, scene)
        if draw_engine_missing(layout):
            return
        if draw_run(layout, scene, ("drawings",), "mgf.make_drawings", "GREASEPENCIL"):
            _draw_pictures(layout, scene)


def _chosen_by_itself(wanted: bpy.types.PropertyGroup) -> bool:
    """Tell whether a number that the panel shows is 0, which stands for the job's own choice."""
    pixel = wanted.resolution == 0 and wanted.kinds & {"orthophotos", "sheets", "quantities"}
    return bool(pixel or (wanted.scale == 0 and "sheets" in wanted.kinds))


def _draw_sections(layout: bpy.types.UILayout, scene: bpy.types.Scene) -> None:
    """Show where the building is cut."""
    column = layout.column(align=True)
    column.prop(scene.mgf.drawings, "height")
    there = find_sections(scene)
    for obj in there:
        row = column.row(align=True)
        row.operator("mgf.select_section", text=obj.name, icon="OBJECT_DATA", translate=False).name = obj.name
        row.operator("mgf.remove_section", text="", icon="X").name = obj.name
    row = column.row(align=True)
    row.operator_menu_enum("mgf.add_section", "axis", icon="ADD")
    row.operator("mgf.use_as_section", text="", icon="RESTRICT_SELECT_OFF")
    if not there and scene.mgf.drawings.height == 0:
        draw_sentence(column, tr("Three cuts through the middle"), "INFO")


def _draw_pictures(layout: bpy.types.UILayout, scene: bpy.types.Scene) -> None:
    """Draw what an earlier run made."""
    index = read_index(job_folder(scene))
    if index is None:
        return
    row = layout.row(align=True)
    page = row.operator("mgf.open_job_file", text="All Drawings", icon="URL")
    page.name = f"{FOLDER}/{PAGE}"
    row.operator("mgf.open_job_file", text="Open Folder", icon="FILE_FOLDER").name = FOLDER
    grid = layout.grid_flow(row_major=True, columns=2, even_columns=True)
    for drawing in index.pictures:
        column, picture = grid.column(align=True), preview_icon(drawing.path)
        if picture:
            column.template_icon(icon_value=picture, scale=_PREVIEW)
        button = column.operator(
            "mgf.show_drawing", text=drawing.title, icon="NONE" if picture else "IMAGE_DATA", translate=False
        )
        button.name = drawing.path.name


register, unregister = bpy.utils.register_classes_factory((MGF_PT_drawings,))
