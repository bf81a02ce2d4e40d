# SPDX-License-Identifier: GPL-3.0-or-later
"""The Models panel: what to make, progress, and the levels of detail in the scene."""

import bpy

from ..common.text import N_, draw_sentence, tr
from ..engine.status_label import draw_engine_missing
from ..job_folder import has_job_file
from ..jobs.finished_job import FinishedJobPanel, draw_run
from ..scene_import.imported_scene import ImportedScene
from .index import FILE, FOLDER
from .lods import LEVEL_KEY, levels_of, shown_level


class MGF_PT_models(FinishedJobPanel, bpy.types.Panel):
    """Levels of detail, solid and other models of the finished job"""

    bl_idname = "MGF_PT_models"
    bl_label = "Models"

    def draw(self, context: bpy.types.Context) -> None:
        layout, scene = self.layout, context.scene
        wanted = scene.mgf.models
        layout.use_property_split = True
        layout.use_property_decorate = False
        column = layout.column()
        column.prop(wanted, "kinds")
        if wanted.kinds & {"lod", "tiles"}:
            column.prop(wanted, "draco")
        if wanted.kinds & {"solid", "ifc"}:
            column.prop(wanted, "detail", text="Detail (cm)")
            if wanted.detail == 0:
                draw_sentence(column, tr("0: chosen automatically"), "INFO")
        if draw_engine_missing(layout):
            return
        idle = draw_run(layout, scene, ("models",), "mgf.make_models", "MOD_DECIM")
        if idle and has_job_file(scene, f"{FOLDER}/{FILE}"):
            _draw_levels(layout, ImportedScene.find(scene))


def _draw_levels(layout: bpy.types.UILayout, imported: ImportedScene | None) -> None:
    """Draw the way to bring the levels in, and which is shown."""
    row = layout.row(align=True)
    row.operator("mgf.import_lods", icon="IMPORT")
    row.operator("mgf.open_job_file", text="", icon="FILE_FOLDER").name = FOLDER
    found = levels_of(imported) if imported is not None else []
    if not found:
        return
    column, shown = layout.column(align=True), shown_level(imported)
    for obj in found:
        level = int(obj[LEVEL_KEY])
        text = tr(N_("Level {level}: {count:,} faces"), level=level, count=len(obj.data.polygons))
        button = column.operator("mgf.show_lod", text=text, depress=level == shown, translate=False)
        button.level = level


register, unregister = bpy.utils.register_classes_factory((MGF_PT_models,))
