# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the Models panel."""

import bpy

from ..common.errors import UserError
from ..common.job import Job
from ..common.operators import Operator
from ..common.selection import select_only
from ..common.text import tr
from ..common.views import draw_texture
from ..job_folder import has_job_file, job_folder, job_name
from ..jobs.operators import FinishedJobOperator, submit
from ..jobs.start import tool_job
from ..results.field import leave_field
from ..scene_import.imported_scene import ImportedScene
from .index import FILE, FOLDER, read_levels
from .lods import import_levels, levels_of, show_level


def models_job(scene: bpy.types.Scene) -> Job:
    """Return the job that makes what the scene's options say; starts nothing.

    Raises:
        UserError: nothing is to be made, or there is no engine.
    """
    wanted = scene.mgf.models
    if not wanted.kinds:
        raise UserError("Nothing is chosen to be made; choose levels of detail, the solid or another kind.")
    command = ["models", str(job_folder(scene)), "--only", ",".join(sorted(wanted.kinds))]
    if wanted.draco:
        command.append("--draco")
    if wanted.detail > 0:
        command += ["--detail", f"{wanted.detail:.6g}"]
    return tool_job(scene, "models", command)


class MGF_OT_make_models(FinishedJobOperator):
    """Make lighter and simpler models of the finished job: levels of detail, solid, IFC, USD, 3D Tiles, points"""

    bl_idname = "mgf.make_models"
    bl_label = "Make Models"

    def run(self, context: bpy.types.Context) -> set[str]:
        return submit(self, models_job(context.scene))


class MGF_OT_import_lods(Operator):
    """Import the levels of detail as one object, the finest shown; replaces only those of an earlier import"""

    bl_idname = "mgf.import_lods"
    bl_label = "Import LODs"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        imported = cls.needs(ImportedScene.find(context.scene) is not None, "Import a result first")
        made = imported and cls.needs(has_job_file(context.scene, f"{FOLDER}/{FILE}"), "Make the models first")
        return made and cls.needs(context.mode == "OBJECT", "Leave the mode first: models come in Object Mode")

    def run(self, context: bpy.types.Context) -> None:
        folder, imported = job_folder(context.scene), ImportedScene.find(context.scene)
        found = import_levels(imported, read_levels(folder), job_name(folder))
        select_only(context, found[0].parent)
        leave_field(context.scene, imported)
        draw_texture(context.scene, True)
        faces = ", ".join(f"{len(o.data.polygons):,}" for o in found)
        self.report({"INFO"}, tr("{count} levels of {faces} faces", count=len(found), faces=faces))


class MGF_OT_show_lod(Operator):
    """Show this level of detail in viewports and renders"""

    bl_idname = "mgf.show_lod"
    bl_label = "Show Level of Detail"
    bl_options = {"REGISTER", "UNDO"}

    level: bpy.props.IntProperty(name="Level", description="0 is the finest", min=0, options={"SKIP_SAVE"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        imported = ImportedScene.find(context.scene)
        return cls.needs(imported is not None and levels_of(imported), "Import the levels of detail first")

    def run(self, context: bpy.types.Context) -> None:
        imported = ImportedScene.find(context.scene)
        show_level(imported, self.level)
        leave_field(context.scene, imported)


CLASSES = (MGF_OT_make_models, MGF_OT_import_lods, MGF_OT_show_lod)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
