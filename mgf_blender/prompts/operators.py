# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the Prompts panel: go through the photos, files, and the mask preview."""

import time

import bpy

from ..common.editors import image_editor, show_image, viewport
from ..common.errors import UserError
from ..common.operators import FileOperator, Operator
from ..common.text import tr
from ..scene_import.cameras import IMAGE_KEY, PHOTO_KEY, SIZE_KEY, find_source
from ..scene_import.operators import sort_photos
from . import files, preview
from .properties import active_photo, photo_image


class MGF_OT_mark_building(Operator):
    """Open the photos to mark in an Image Editor, with the point tool active"""

    bl_idname = "mgf.mark_building"
    bl_label = "Mark Building"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return cls.needs(active_photo(context.scene) is not None, "Import a scene first")

    def run(self, context: bpy.types.Context) -> None:
        open_photo(context)


class MGF_OT_show_viewport(Operator):
    """Go back from the photos to the 3D viewport"""

    bl_idname = "mgf.show_viewport"
    bl_label = "Show 3D Viewport"

    def run(self, context: bpy.types.Context) -> None:
        viewport(context)


class MGF_OT_next_photo(Operator):
    """Go to the next photo to click on"""

    bl_idname = "mgf.next_photo"
    bl_label = "Next Photo"
    bl_options = {"REGISTER", "UNDO"}

    step: bpy.props.IntProperty(name="Step", description="Number of photos to advance", default=1)

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        return tr("Go to the previous photo") if properties.step < 0 else tr("Go to the next photo")

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return cls.needs(len(context.scene.mgf.photos), "Import a scene first")

    def run(self, context: bpy.types.Context) -> None:
        state = context.scene.mgf
        state.photo_index = (state.photo_index + self.step) % len(state.photos)


class MGF_OT_add_photo(Operator):
    """Add the active camera's photo to the list"""

    bl_idname = "mgf.add_photo"
    bl_label = "Add Photo of Active Camera"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        camera = context.scene.camera
        return cls.needs(camera is not None and PHOTO_KEY in camera, "Look through an imported camera first")

    def run(self, context: bpy.types.Context) -> None:
        camera, state = context.scene.camera, context.scene.mgf
        if state.photos.find(camera[PHOTO_KEY]) < 0 and not _photo_file(camera):
            raise UserError("The photo of this camera was not found; set the photo folder and import again.")
        choose_photo(state, camera)


class MGF_OT_remove_photo(Operator):
    """Remove the photo and its points from the list"""

    bl_idname = "mgf.remove_photo"
    bl_label = "Remove Photo"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return active_photo(context.scene) is not None

    def run(self, context: bpy.types.Context) -> None:
        state = context.scene.mgf
        state.photos.remove(state.photo_index)
        state.photo_index = max(0, state.photo_index - 1)


class MGF_OT_clear_clicks(Operator):
    """Remove all points of this photo"""

    bl_idname = "mgf.clear_clicks"
    bl_label = "Clear Points"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        photo = active_photo(context.scene)
        return photo is not None and len(photo.clicks) > 0

    def run(self, context: bpy.types.Context) -> None:
        active_photo(context.scene).clicks.clear()


class MGF_OT_import_prompts(FileOperator):
    """Import points from a prompts.json file; they replace those of the same photos"""

    bl_idname = "mgf.import_prompts"
    bl_label = "Import Prompts"
    bl_options = {"REGISTER", "UNDO"}

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_glob: bpy.props.StringProperty(default="*.json", options={"HIDDEN"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self.execute(context) if self.filepath else super().invoke(context, event)  # a path: dropped

    def run(self, context: bpy.types.Context) -> None:
        scene = context.scene
        found = files.read(self.chosen_file())
        add_missing(scene, list(found))
        unknown = files.replace_clicks(scene, found)
        if unknown and len(unknown) == len(found):
            raise UserError(
                "The scene has no photo '{unknown}'; import the scene that belongs to these prompts.",
                unknown=unknown[0],
            )
        if unknown:
            self.report({"WARNING"}, tr("{count} photos of the file are not in the scene", count=len(unknown)))


class MGF_OT_export_prompts(FileOperator):
    """Write the points to a prompts.json file"""

    bl_idname = "mgf.export_prompts"
    bl_label = "Export Prompts"
    bl_options = {"REGISTER"}

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", default="prompts.json", options={"SKIP_SAVE"})
    check_existing: bpy.props.BoolProperty(default=True, options={"HIDDEN"})
    filter_glob: bpy.props.StringProperty(default="*.json", options={"HIDDEN"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return cls.needs(any(len(p.clicks) for p in context.scene.mgf.photos), "There are no points yet")

    def run(self, context: bpy.types.Context) -> None:
        path = self.chosen_file()
        files.write(context.scene, path if path.suffix else path.with_suffix(".json"))


class MGF_OT_preview_mask(Operator):
    """Preview the mask that the points of this photo alone give, within seconds"""

    bl_idname = "mgf.preview_mask"
    bl_label = "Preview Mask"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        photo = active_photo(context.scene)
        return cls.needs(
            photo is not None and photo.done(), "Click at least one point on the building in this photo first"
        )

    def run(self, context: bpy.types.Context) -> set[str]:
        found = preview.start(context.scene, active_photo(context.scene))
        context.scene.mgf.show_mask = True
        if not bpy.app.background:
            return {"FINISHED"}
        while found.drain():  # without a window there is no timer
            time.sleep(0.02)
        if found.status == preview.FAILED:
            raise UserError(found.text)
        return {"FINISHED"}


class MGF_OT_cancel_preview(Operator):
    """Stop the preview"""

    bl_idname = "mgf.cancel_preview"
    bl_label = "Cancel"
    bl_options = {"INTERNAL"}

    def run(self, context: bpy.types.Context) -> None:
        preview.stop()


class MGF_FH_prompts(bpy.types.FileHandler):
    """Dropping a prompts file on a photo reads its points."""

    bl_idname = "MGF_FH_prompts"
    bl_label = "Prompts"
    bl_import_operator = "mgf.import_prompts"
    bl_file_extensions = ".json"

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        in_editor = context.area is not None and context.area.type == "IMAGE_EDITOR"
        return in_editor and len(context.scene.mgf.photos) > 0


def open_photo(context: bpy.types.Context) -> None:
    """Show the chosen photo in an Image Editor, with the point tool active.

    Raises:
        UserError: the photo was not found.
    """
    image = photo_image(active_photo(context.scene))
    if image is None:
        raise UserError("The photo was not found; set the photo folder and import again.")
    show_image(context, image)
    area = image_editor(context)
    if area is not None:
        with context.temp_override(area=area, region=next(r for r in area.regions if r.type == "WINDOW")):
            bpy.ops.mgf.use_point_tool()


def choose_photo(state: bpy.types.PropertyGroup, camera: bpy.types.Object) -> None:
    """Choose the photo of an imported camera in the list, which gets it where it lacks it."""
    if state.photos.find(camera[PHOTO_KEY]) < 0:
        list_photo(state, camera)
    state.photo_index = state.photos.find(camera[PHOTO_KEY])


def add_missing(scene: bpy.types.Scene, names: list[str]) -> None:
    """Add photos that a prompts file names and an imported camera shows, but the list lacks."""
    imported = find_source(scene)
    if imported is None:
        return
    have = {p.name for p in scene.mgf.photos}
    for camera in imported.objects("Cameras"):
        name = camera.get(PHOTO_KEY, "")
        if name in names and name not in have:
            list_photo(scene.mgf, camera)


def list_photo(state: bpy.types.PropertyGroup, camera: bpy.types.Object) -> None:
    """Put the photo of an imported camera into the list."""
    entry = state.photos.add()
    entry.name, entry.file = camera[PHOTO_KEY], _photo_file(camera)
    entry.width, entry.height = camera[SIZE_KEY]
    sort_photos(state)


def _photo_file(camera: bpy.types.Object) -> str:
    """Return the photo that an imported camera shows; empty when it was not found."""
    images = [s.image for s in camera.data.background_images if s.image is not None]
    return next((bpy.path.abspath(i.filepath) for i in images if i.get(IMAGE_KEY) == "photo"), "")


CLASSES = (
    MGF_OT_mark_building, MGF_OT_show_viewport, MGF_OT_next_photo, MGF_OT_add_photo, MGF_OT_remove_photo,
    MGF_OT_clear_clicks, MGF_OT_import_prompts,
    MGF_OT_export_prompts, MGF_OT_preview_mask, MGF_OT_cancel_preview,
    MGF_FH_prompts,
)  # fmt: skip


register, unregister = bpy.utils.register_classes_factory(CLASSES)
