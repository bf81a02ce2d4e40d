# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the Results panel, and the one that looks through a camera, which then shows photo or render."""

import json
import shutil
from pathlib import Path

import bpy

from ..common.errors import UserError, sentence
from ..common.files import replace_file
from ..common.operators import FileOperator, Operator
from ..common.selection import active_object, select_none, select_only
from ..common.text import tr
from ..common.views import draw_texture, enter_camera, follow_paint
from ..job_folder import has_job_file, job_folder
from ..prompts import files as prompts_files
from ..prompts.operators import add_missing
from ..scene_import.cameras import PHOTO_KEY, SHOWN_KEY, clear_view, fit_render
from ..scene_import.framing import frame_object
from ..scene_import.imported_scene import ImportedScene, hide
from ..scene_import.operators import SceneOperator
from . import async_import, surface, view_mode
from .delivery import read_delivery
from .field import import_field, leave_field, show_field, shown_fields
from .load import fitting_scene, import_result
from .runs import old_runs, remove_runs, shown_runs


class _NeedsJob(Operator):
    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return cls.needs(has_job_file(context.scene, "deliver.json"), "The job folder holds no finished job")


class MGF_OT_import_result(FileOperator):
    """Import mesh and renders of the job; replaces only the objects of an earlier import"""

    bl_idname = "mgf.import_result"
    bl_label = "Import Result"
    bl_options = {"REGISTER", "UNDO"}

    directory: bpy.props.StringProperty(
        name="Job Folder", description="Folder of a finished job; empty takes the scene's own", subtype="DIR_PATH",
        options={"SKIP_SAVE"},
    )  # fmt: skip

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if self.directory or has_job_file(context.scene, "deliver.json"):
            return self.execute(context)
        return super().invoke(context, event)

    def _folder(self, scene: bpy.types.Scene) -> Path:
        if not self.directory and not scene.mgf.job_folder:
            raise UserError("No job was chosen; choose the folder of a finished job.")
        return Path(bpy.path.abspath(self.directory)) if self.directory else job_folder(scene)

    def run(self, context: bpy.types.Context) -> set[str] | None:
        scene = context.scene
        folder = self._folder(scene)
        there = async_import.ready(scene, folder)
        if there is None and self.options.is_invoke and not bpy.app.background:
            async_import.begin(scene, folder)
            return {"CANCELLED"}  # nothing has changed yet; the last step calls this again, as one undo step
        content = there.take_content() if there is not None else None
        mesh = there.take_mesh() if there is not None else None
        if there is None:
            async_import.forget(scene)
        imported = fitting_scene(scene, folder)
        first = imported is None or not imported.objects("Mesh")
        result = import_result(scene, folder, imported, content, mesh)
        if result.mesh is not None and context.mode == "OBJECT":
            select_only(context, result.mesh)
            if first:
                frame_object(context, result.mesh, result.imported)
        scene.mgf.figures = json.dumps(result.delivery.figures)
        scene.mgf.job_folder = scene.mgf.job_folder or str(folder)
        self._restore_clicks(scene, folder / "prompts.json")
        faces = len(result.mesh.data.polygons) if result.mesh is not None else 0
        self.report({"INFO"}, tr("Mesh of {faces} faces, {renders} renders", faces=faces, renders=result.renders))
        return None

    def _restore_clicks(self, scene: bpy.types.Scene, path: Path) -> None:
        """Put the clicks of the job into a scene without any: a new run from it would begin without them."""
        if any(len(photo.clicks) for photo in scene.mgf.photos) or not path.is_file():
            return
        try:
            found = prompts_files.read(path)
        except UserError as error:  # the mesh is there all the same
            self.report({"WARNING"}, sentence(error))
            return
        add_missing(scene, list(found))
        unknown = prompts_files.replace_clicks(scene, found)
        if len(unknown) < len(found):
            self.report({"INFO"}, tr("Points on {count} photos come from the job", count=len(found) - len(unknown)))


class MGF_OT_import_field(_NeedsJob):
    """Import the Gaussian field as colored points in place of the mesh; Texture or Colors shows that again"""

    bl_idname = "mgf.import_field"
    bl_label = "Import Field as Points"
    bl_options = {"REGISTER", "UNDO"}

    def run(self, context: bpy.types.Context) -> None:
        delivery = read_delivery(job_folder(context.scene))
        imported = ImportedScene.find(context.scene)
        if delivery.field is None or imported is None:
            raise UserError("The job has no field or its scene is gone; import the result first.")
        import_field(imported, delivery.field)
        select_none(context)  # a selected point is drawn in the colour of the selection
        show_field(context.scene, imported)


class MGF_OT_look_through(SceneOperator):
    """Look through a camera; the render takes the size and pixel aspect of its photo"""

    bl_idname = "mgf.look_through"
    bl_label = "Look Through Camera"
    bl_options = {"REGISTER", "UNDO"}

    step: bpy.props.IntProperty(
        name="Step", description="Number of photos to advance from the active camera", default=0
    )

    def run(self, context: bpy.types.Context) -> None:
        imported = ImportedScene.find(context.scene)
        cameras = sorted(imported.cameras(), key=lambda o: o.get(PHOTO_KEY, ""))
        active = active_object(context)
        chosen = active if self.step == 0 and active in cameras else context.scene.camera
        at = cameras.index(chosen) if chosen in cameras else 0
        camera = cameras[(at + self.step) % len(cameras)]
        context.scene.camera = camera
        fit_render(context.scene, camera)
        clear_view(imported, camera)
        view_mode.follow(imported, camera)
        enter_camera(context)


class MGF_OT_show_in_camera(Operator):
    """Show photo, render, error map, or mesh over photo in the camera view"""

    bl_idname = "mgf.show_in_camera"
    bl_label = "Show in Camera"
    bl_options = {"REGISTER", "UNDO"}

    kind: bpy.props.EnumProperty(
        name="Show",
        description="Content of the camera view",
        items=[
            ("PHOTO", "Photo", "The photo alone"),
            ("RENDER", "Render", "Render of the trained field"),
            ("ERROR", "Error", "Difference between photo and render"),
            ("MESH", "Mesh", "The mesh, with the photo behind it"),
        ],
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        camera = context.scene.camera
        imported = camera is not None and PHOTO_KEY in camera and ImportedScene.find(context.scene) is not None
        return cls.needs(imported, "Look through an imported camera first")

    def run(self, context: bpy.types.Context) -> None:
        imported = ImportedScene.find(context.scene)
        view_mode.show(imported, context.scene.camera, self.kind)
        leave_field(context.scene, imported)
        if self.kind != "MESH":
            enter_camera(context)
        imported.root[SHOWN_KEY] = self.kind  # the next camera goes on with it


class MGF_OT_paint_mesh(Operator):
    """Set the colors of the mesh in the viewport and in renders"""

    bl_idname = "mgf.paint_mesh"
    bl_label = "Paint Mesh"
    bl_options = {"REGISTER", "UNDO"}

    kind: bpy.props.EnumProperty(
        name="Paint",
        description="Content of the mesh colors",
        items=[
            ("TEXTURE", "Texture", "Texture from the photos at full size"),
            ("COLOR", "Colors", "Colors of the photos"),
            ("CONFIDENCE", "Confidence", "Confidence of the mesh, from violet (low) to yellow (high)"),
            ("VIEWS", "Views", "Number of photos that show each vertex, from violet (none) to yellow (most)"),
        ],
        default="COLOR",
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        imported = ImportedScene.find(context.scene)
        return cls.needs(imported is not None and imported.objects("Mesh"), "Import a result first")

    def run(self, context: bpy.types.Context) -> None:
        imported = ImportedScene.find(context.scene)
        for obj in imported.objects("Mesh"):
            surface.show(obj.data, self.kind)
            hide(obj, False)
        for level in imported.objects("LODs"):
            hide(level)  # the finest lies on the mesh
        leave_field(context.scene, imported)
        draw_texture(context.scene, self.kind == "TEXTURE")


class MGF_OT_export_field(_NeedsJob, FileOperator):
    """Save the Gaussian field as a standard 3DGS PLY file, for viewers and for Blender 5.3 and later"""

    bl_idname = "mgf.export_field"
    bl_label = "Save Field As"

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", default="field.ply", options={"SKIP_SAVE"})
    check_existing: bpy.props.BoolProperty(default=True, options={"HIDDEN"})
    filter_glob: bpy.props.StringProperty(default="*.ply", options={"HIDDEN"})

    def run(self, context: bpy.types.Context) -> None:
        delivery = read_delivery(job_folder(context.scene))
        if delivery.field is None:
            raise UserError("The job has no field; run the job again.")
        path = self.chosen_file().with_suffix(".ply")
        replace_file(path, lambda temporary: shutil.copyfile(delivery.field, temporary))
        self.report({"INFO"}, tr("Saved {path}", path=path))


class MGF_OT_remove_old_runs(Operator):
    """Delete results of earlier runs, except those this file shows; other files that show them lose their textures"""

    bl_idname = "mgf.remove_old_runs"
    bl_label = "Remove Old Runs"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        there = has_job_file(context.scene, "runs") and old_runs(job_folder(context.scene))
        return cls.needs(there, "The job has no earlier runs")

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return context.window_manager.invoke_confirm(self, event)

    def run(self, context: bpy.types.Context) -> None:
        runs = old_runs(job_folder(context.scene))
        shown = shown_runs(runs)
        remove_runs([run for run in runs if run not in shown])
        self.report(
            {"INFO"},
            tr("{count} earlier runs removed; {kept} in use stay", count=len(runs) - len(shown), kept=len(shown)),
        )


CLASSES = (
    MGF_OT_import_result, MGF_OT_import_field, MGF_OT_export_field, MGF_OT_look_through, MGF_OT_show_in_camera,
    MGF_OT_paint_mesh, MGF_OT_remove_old_runs,
)  # fmt: skip


_lit: set[str] = set()  # names of the scenes that showed a mesh, not points, when an undo began


@bpy.app.handlers.persistent
def before_undo(*_: object) -> None:
    """Note which scenes show a mesh (handler)."""
    _lit.clear()
    _lit.update(scene.name for scene in bpy.data.scenes if _shows_mesh(ImportedScene.find(scene)))


@bpy.app.handlers.persistent
def after_undo(*_: object) -> None:
    """Update how the viewports draw the mesh, or the points without it (handler): an undo changes only what it is
    painted with, and whether it is there."""
    for scene in bpy.data.scenes:
        imported = ImportedScene.find(scene)
        if imported is not None:
            lit, was_lit = _shows_mesh(imported), scene.name in _lit
            follow_paint(scene, lit and imported.shows_texture, lit if lit != was_lit else None)


def _shows_mesh(imported: ImportedScene | None) -> bool:
    return imported is not None and bool(imported.objects("Mesh")) and not shown_fields(imported)


_HANDLERS = (
    (bpy.app.handlers.undo_pre, before_undo),
    (bpy.app.handlers.redo_pre, before_undo),
    (bpy.app.handlers.undo_post, after_undo),
    (bpy.app.handlers.redo_post, after_undo),
)
_register, _unregister = bpy.utils.register_classes_factory(CLASSES)


def register() -> None:
    """Register the operators and what follows an undo."""
    _register()
    for handlers, function in _HANDLERS:
        handlers.append(function)


def unregister() -> None:
    """Take them away again."""
    for handlers, function in _HANDLERS:
        handlers.remove(function)
    _unregister()
