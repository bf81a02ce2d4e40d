# SPDX-License-Identifier: GPL-3.0-or-later
"""The Models panel: what to make, progress, and the levels of detail in the scene."""

import bpy

from ..common.text import N_, tr
from ..engine.status_label import draw_engine_missing
from ..reconstruct.operators import last_job
from ..reconstruct.panel import draw_job
from ..reconstruct.start import has_job_file
from ..scene_import.tree import Tree
from .index import FILE, FOLDER
from .lods import LEVEL_KEY, levels_of, shown_level


class MGF_PT_models(bpy.types.Panel):
    """Levels of detail, solid and other models of the finished job"""

    bl_idname = "MGF_PT_models"
    bl_label = "Models"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "MGF"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_job_file(context.scene, "deliver.json")

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
        if draw_engine_missing(layout):
            return
        job = last_job(scene, ("models",))
        if job is None or not job.live:
            row = layout.row()
            row.scale_y = 1.4
            row.operator("mgf.make_models", icon="MOD_DECIM")
        if job is not None:
            draw_job(layout, job)
        if has_job_file(scene, f"{FOLDER}/{FILE}") and (job is None or not job.live):
            _draw_levels(layout, Tree.find(scene))


def _draw_levels(layout: bpy.types.UILayout, tree: Tree | None) -> None:
    """The way to bring the levels in, and which is shown."""
    row = layout.row(align=True)
    row.operator("mgf.import_lods", icon="IMPORT")
    row.operator("mgf.open_job_file", text="", icon="FILE_FOLDER").name = FOLDER
    found = levels_of(tree) if tree is not None else []
    if not found:
        return
    column, shown = layout.column(align=True), shown_level(tree)
    for obj in found:
        level = int(obj[LEVEL_KEY])
        text = tr(N_("Level {level}: {count:,} faces"), level=level, count=len(obj.data.polygons))
        button = column.operator("mgf.show_lod", text=text, depress=level == shown, translate=False)
        button.level = level


register, unregister = bpy.utils.register_classes_factory((MGF_PT_models,))
