# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the Reconstruct panel."""

from pathlib import Path

import bpy

from ..common import options, runner
from ..common.editors import show_image
from ..common.errors import UserError
from ..common.files import open_file
from ..common.job import DONE
from ..common.operators import FileOperator, Operator
from ..common.text import tr
from ..engine.environment import engine_python
from ..job_folder import broke_off, given_options, has_job_file, job_folder
from ..jobs.operators import JobOperator, submit
from ..scene_import.cameras import find_source
from ..scene_import.crop import crop_text
from ..scene_import.framing import frame_imported
from ..scene_import.locate import holds_model, holds_photos
from ..scene_import.operators import bring_in, leave_job
from ..scene_keys import key_of
from . import preview_image
from .start import make_job


class MGF_OT_reconstruct(JobOperator):
    """Reconstruct the building; the mesh is imported when the job ends"""

    bl_idname = "mgf.reconstruct"
    bl_label = "Reconstruct Building"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        state = context.scene.mgf
        wanted = state.source and state.options.use_masks and not state.masks_folder and len(state.photos)
        ready = not wanted or any(p.done() for p in state.photos)
        known = cls.needs(
            ready, "Mark the building in one photo or more first, or choose your own masks under Advanced Options"
        )
        return known and super().poll(context)

    def run(self, context: bpy.types.Context) -> set[str]:
        context.view_layer.update()  # the crop box may have been moved by a script
        context.scene.mgf.options.crop_box = crop_text(find_source(context.scene))
        return submit(self, make_job(context.scene))


class MGF_OT_find_masks(JobOperator):
    """Make the masks of all photos from the points so far; the reconstruction reuses them"""

    bl_idname = "mgf.find_masks"
    bl_label = "Find Masks in All Photos"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        marked = any(p.done() for p in context.scene.mgf.photos)
        return cls.needs(marked, "Click at least one point on the building first") and super().poll(context)

    def run(self, context: bpy.types.Context) -> set[str]:
        return submit(self, make_job(context.scene, "masks"))


class MGF_OT_resume(JobOperator):
    """Continue the job in the job folder from its last checkpoint, with the options it was given"""

    bl_idname = "mgf.resume"
    bl_label = "Resume"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        begun = has_job_file(context.scene, "job.json")
        return cls.needs(begun, "There is no job to continue") and super().poll(context)

    def run(self, context: bpy.types.Context) -> set[str]:
        given, values = given_options(job_folder(context.scene)), context.scene.mgf.options
        before, last = {"preset": values.preset, **options.changed(values)}, runner.last_job(key_of(context.scene))
        kind = last.kind if last is not None and last.status != DONE else "reconstruct"
        if given:
            options.replace(values, given)
        try:
            return submit(self, make_job(context.scene, kind))
        except UserError:  # nothing was started
            options.replace(values, before)
            raise


class MGF_OT_cancel_job(Operator):
    """Stop the job; finished work is kept, and Resume continues it"""

    bl_idname = "mgf.cancel_job"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return cls.needs(runner.live_job(key_of(context.scene)), "No job is running")

    def run(self, context: bpy.types.Context) -> None:
        runner.live_job(key_of(context.scene)).cancel()


class MGF_OT_import_photos(FileOperator):
    """Find the cameras of a folder of photos; needs no COLMAP model"""

    bl_idname = "mgf.import_photos"
    bl_label = "Import Photos"
    bl_options = {"REGISTER", "UNDO"}

    directory: bpy.props.StringProperty(subtype="DIR_PATH", options={"SKIP_SAVE"})
    filter_folder: bpy.props.BoolProperty(default=True, options={"HIDDEN"})
    filter_image: bpy.props.BoolProperty(default=True, options={"HIDDEN"})

    def run(self, context: bpy.types.Context) -> set[str]:
        folder = Path(bpy.path.abspath(self.directory))
        if not holds_photos(folder):
            raise UserError("'{folder}' holds no photos; choose the folder they lie in.", folder=folder)
        state = context.scene.mgf
        if holds_model(folder):  # the engine would find no cameras but take those that are there
            done = bring_in(context.scene, folder, True, True, self)
            if done.other:
                leave_job(context.scene)
            self.report({"INFO"}, tr("The folder holds a COLMAP model; its cameras were imported"))
            frame_imported(context, done.imported)
            return {"FINISHED"}
        engine_python()  # before anything changes
        if state.source != str(folder):
            state.source, state.photo_folder = str(folder), ""
            leave_job(context.scene)
        return submit(self, make_job(context.scene, "scene"))


class MGF_OT_import_sfm(Operator):
    """Import the cameras that the engine found for the photos"""

    bl_idname = "mgf.import_sfm"
    bl_label = "Import Found Cameras"
    bl_options = {"REGISTER", "UNDO", "INTERNAL"}

    directory: bpy.props.StringProperty(
        name="Job Folder", description="Folder of the job; empty takes the scene's own", subtype="DIR_PATH",
        options={"SKIP_SAVE"},
    )  # fmt: skip

    def run(self, context: bpy.types.Context) -> None:
        state = context.scene.mgf
        folder = Path(bpy.path.abspath(self.directory)) if self.directory else job_folder(context.scene)
        source, model = state.source, folder / "scene" / "sfm" / "model"
        if not model.is_dir():
            raise UserError("The job found no cameras; open its log for the reason.")
        state.photo_folder = state.photo_folder or source
        done = bring_in(context.scene, model, True, True, self, Path(source))
        frame_imported(context, done.imported)
        state.source = source


class MGF_OT_show_preview(Operator):
    """Show the latest picture of the job in an Image Editor: the masks, or a photo beside its render during training"""

    bl_idname = "mgf.show_preview"
    bl_label = "Show Preview"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return cls.needs(preview_image.NAME in bpy.data.images, "The job has no picture yet")

    def run(self, context: bpy.types.Context) -> None:
        show_image(context, bpy.data.images[preview_image.NAME])


class MGF_OT_open_job_file(Operator):
    """Open a file of the job in the program the system has for it"""

    bl_idname = "mgf.open_job_file"
    bl_label = "Open"
    bl_options = {"INTERNAL"}

    name: bpy.props.StringProperty(name="File", description="File of the job folder", default="log.txt")
    directory: bpy.props.StringProperty(
        name="Job Folder", description="Folder of the job; empty takes the scene's own", subtype="DIR_PATH",
        options={"SKIP_SAVE"},
    )  # fmt: skip

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        return tr("Open {name} of the job", name=properties.name)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        there = has_job_file(context.scene) or runner.last_job(key_of(context.scene)) is not None
        return cls.needs(there, "No job has run yet")

    def run(self, context: bpy.types.Context) -> None:
        path = (Path(self.directory) if self.directory else job_folder(context.scene)) / self.name
        if not path.exists():
            raise UserError("The job has no {name} yet.", name=self.name)
        open_file(path)


class MGF_OT_reset_options(Operator):
    """Set all options back to the preset"""

    bl_idname = "mgf.reset_options"
    bl_label = "Reset Options"
    bl_options = {"REGISTER", "UNDO"}

    def run(self, context: bpy.types.Context) -> None:
        options.reset(context.scene.mgf.options)


def interrupted(scene: bpy.types.Scene) -> bool:
    """Tell whether the job folder holds a job that did not end and that nobody runs, for example after a crash."""
    if runner.live_job(key_of(scene)):
        return False
    return has_job_file(scene, "job.json") and broke_off(job_folder(scene))


CLASSES = (
    MGF_OT_reconstruct, MGF_OT_find_masks, MGF_OT_resume, MGF_OT_cancel_job, MGF_OT_import_photos, MGF_OT_import_sfm,
    MGF_OT_show_preview, MGF_OT_open_job_file, MGF_OT_reset_options,
)  # fmt: skip


register, unregister = bpy.utils.register_classes_factory(CLASSES)
