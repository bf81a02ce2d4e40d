# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that bring a scene in: import, drop, crop box; and the handler that fits the render to its cameras."""

from pathlib import Path

import bpy

from ..common import runner
from ..common.errors import UserError
from ..common.operators import FileOperator, Operator
from ..common.selection import select_only
from ..common.text import tr
from ..scene_keys import key_of
from .cameras import SIZE_KEY, clear_view, fit_render
from .crop import add_crop_box, find_crop_box
from .framing import frame_imported
from .imported_scene import ImportedScene
from .load import SceneImport, import_scene
from .locate import find_photo
from .roots import choose_roots


class SceneOperator(Operator):
    """Base of operators that need an imported scene."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return cls.needs(ImportedScene.find(context.scene) is not None, "Import a scene first")


class MGF_OT_import_colmap(FileOperator):
    """Import cameras with their photos and the sparse points of a COLMAP model"""

    bl_idname = "mgf.import_colmap"
    bl_label = "Import COLMAP"  # the File Browser cuts longer ones off
    bl_options = {"REGISTER", "UNDO"}

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})
    directory: bpy.props.StringProperty(subtype="DIR_PATH", options={"SKIP_SAVE", "HIDDEN"})
    filter_glob: bpy.props.StringProperty(default="*.bin;*.txt", options={"HIDDEN"})
    upright: bpy.props.BoolProperty(
        name="Turn Upright",
        description="Use the cameras' up direction as Z and put the ground at zero",
        default=True,
    )
    replace: bpy.props.BoolProperty(
        name="Replace Earlier Import",
        description="Replace the objects of an earlier import; other objects are kept",
        default=True,
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self.execute(context) if self.filepath else super().invoke(context, event)  # a path: dropped

    def run(self, context: bpy.types.Context) -> None:
        text = self.filepath or self.directory
        if not text:
            raise UserError("No model was chosen; choose a COLMAP model or its folder.")
        path = Path(bpy.path.abspath(text))
        if not path.exists() and self.directory:
            path = Path(bpy.path.abspath(self.directory))  # the file browser adds a file name to a folder
        done = bring_in(context.scene, path, self.upright, self.replace, self)
        if done.other:
            leave_job(context.scene)
        frame_imported(context, done.imported)


class MGF_OT_reload_scene(Operator):
    """Import the source again; replaces only the add-on's own objects"""

    bl_idname = "mgf.reload_scene"
    bl_label = "Import Again"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return cls.needs(context.scene.mgf.source, "Import a scene first")

    def run(self, context: bpy.types.Context) -> None:
        if bring_in(context.scene, Path(bpy.path.abspath(context.scene.mgf.source)), True, True, self).other:
            leave_job(context.scene)


class MGF_OT_add_crop_box(SceneOperator):
    """Add a box around the points; only its inside is meshed. Move, rotate and scale it like any object"""

    bl_idname = "mgf.add_crop_box"
    bl_label = "Add Crop Box"
    bl_options = {"REGISTER", "UNDO"}

    def run(self, context: bpy.types.Context) -> None:
        context.view_layer.update()
        select_only(context, add_crop_box(ImportedScene.find(context.scene)))


class _NeedsCropBox(Operator):
    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return cls.needs(find_crop_box(ImportedScene.find(context.scene)) is not None, "There is no crop box")


class MGF_OT_select_crop_box(_NeedsCropBox):
    """Select the crop box"""

    bl_idname = "mgf.select_crop_box"
    bl_label = "Select Crop Box"
    bl_options = {"REGISTER", "UNDO"}

    def run(self, context: bpy.types.Context) -> None:
        select_only(context, find_crop_box(ImportedScene.find(context.scene)))


class MGF_OT_remove_crop_box(_NeedsCropBox):
    """Remove the crop box; the next reconstruction meshes everything"""

    bl_idname = "mgf.remove_crop_box"
    bl_label = "Remove Crop Box"
    bl_options = {"REGISTER", "UNDO"}

    def run(self, context: bpy.types.Context) -> None:
        bpy.data.objects.remove(find_crop_box(ImportedScene.find(context.scene)), do_unlink=True)


class MGF_FH_colmap(bpy.types.FileHandler):
    """Dropping a model's file into the 3D viewport imports the model."""

    bl_idname = "MGF_FH_colmap"
    bl_label = "COLMAP Scene"
    bl_import_operator = "mgf.import_colmap"
    bl_file_extensions = ".bin;.txt"

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        return context.area is not None and context.area.type == "VIEW_3D"


def bring_in(
    scene: bpy.types.Scene,
    path: Path,
    upright: bool,
    replace: bool,
    operator: bpy.types.Operator | None = None,
    named: Path | None = None,
) -> SceneImport:
    """Import into a scene and remember source and root photos, as every way of importing does.

    Args:
        scene: to import into.
        path: of the model, or a folder around it.
        upright: turn the scene so that the photos' up is z.
        replace: an earlier import gives way.
        operator: takes warnings, where one runs.
        named: the folder that gives the collection its name; None takes ``path``.
    """
    state, path = scene.mgf, path.absolute()
    photos = Path(bpy.path.abspath(state.photo_folder)) if state.photo_folder else None
    done = import_scene(scene, path, photos, upright, ImportedScene.find(scene) if replace else None, named)
    state.source = str(path.parent if path.is_file() else path)
    list_roots(scene, done)
    if operator is not None:
        operator.report({"INFO"}, tr("{cameras} cameras, {points} points", **done.counts()))
        for text in done.warnings:
            operator.report({"WARNING"}, text)
    return done


def leave_job(scene: bpy.types.Scene) -> None:
    """Let a scene that gets other photos forget its job: the folder, the figures, and how it ended."""
    scene.mgf.job_folder = scene.mgf.figures = ""
    runner.forget(key_of(scene))


def list_roots(scene: bpy.types.Scene, done: SceneImport) -> None:
    """Put the root photos into the list; photos with clicks of the same names keep them."""
    model = done.model
    names = {model.photos[i].name for i in choose_roots(model)}
    photos = scene.mgf.photos
    known = {p.name for p in model.photos}
    for i in reversed(range(len(photos))):
        if photos[i].name not in known or (photos[i].name not in names and not len(photos[i].clicks)):
            photos.remove(i)
    have = {p.name for p in photos}
    for photo in model.photos:
        if photo.name in names or photo.name in have:
            # Looked up anew each time: adding to a collection moves its items.
            entry = photos[photo.name] if photo.name in have else photos.add()
            entry.name = photo.name
            entry.width, entry.height = photo.camera.width, photo.camera.height
            file = find_photo(done.photo_folder, photo.name) if done.photo_folder is not None else None
            entry.file = str(file) if file is not None else ""
    scene.mgf.photo_index = min(max(scene.mgf.photo_index, 0), max(len(photos) - 1, 0))
    sort_photos(scene.mgf)


def sort_photos(state: bpy.types.PropertyGroup) -> None:
    """Put the listed photos in the order of their names; the chosen one stays so."""
    photos = state.photos
    chosen = photos[state.photo_index].name if 0 <= state.photo_index < len(photos) else ""
    for at, name in enumerate(sorted(photo.name for photo in photos)):
        photos.move(photos.find(name), at)
    if chosen and photos.find(chosen) != state.photo_index:
        state.photo_index = photos.find(chosen)


@bpy.app.handlers.persistent
def fit_on_camera_change(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """Keep the render size in step with the active camera (handler), because Blender keeps it in the scene."""
    camera, before = scene.camera, _last.get(scene.name)
    _last[scene.name] = camera.name if camera is not None else ""
    if camera is None or SIZE_KEY not in camera or before == camera.name:
        return
    if scene.mgf.fit_render:
        fit_render(scene, camera)
    imported = ImportedScene.find(scene)
    if imported is not None:
        clear_view(imported, camera)


_last: dict[str, str] = {}  # scene name -> name of the camera seen last


def menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Draw the entry of File > Import."""
    self.layout.operator(MGF_OT_import_colmap.bl_idname, text="COLMAP Scene (.bin/.txt)")


CLASSES = (
    MGF_OT_import_colmap, MGF_OT_reload_scene, MGF_OT_add_crop_box, MGF_OT_select_crop_box, MGF_OT_remove_crop_box,
    MGF_FH_colmap,
)  # fmt: skip


def register() -> None:
    """Register operators, the drop handler, the menu entry and the camera handler."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.TOPBAR_MT_file_import.append(menu)
    bpy.app.handlers.depsgraph_update_post.append(fit_on_camera_change)


def unregister() -> None:
    """Take them away again."""
    bpy.app.handlers.depsgraph_update_post.remove(fit_on_camera_change)
    bpy.types.TOPBAR_MT_file_import.remove(menu)
    _last.clear()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
