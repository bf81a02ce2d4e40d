# SPDX-License-Identifier: GPL-3.0-or-later
"""Clicks as Blender properties: pixels of the user's own photo, (0, 0) its top-left corner."""

import os
from pathlib import Path

import bpy

from ..common.editors import fit_photo
from ..scene_import.cameras import IMAGE_KEY

BUILDING = "building"


class MGF_PG_click(bpy.types.PropertyGroup):
    """One click on a photo."""

    uv: bpy.props.FloatVectorProperty(name="Pixel", description="Position in pixels from the top left", size=2)
    negative: bpy.props.BoolProperty(name="Negative", description="The point is not on the building")
    part: bpy.props.StringProperty(
        name="Part", description="Part of the building that the point marks", default=BUILDING
    )
    proposed: bpy.props.BoolProperty(
        name="Proposed", description="The engine proposes the point; it does not count until it is accepted"
    )


class MGF_PG_photo(bpy.types.PropertyGroup):
    """A photo to click on; ``name`` is its name in the COLMAP model."""

    file: bpy.props.StringProperty(name="File", description="The photo on disk", subtype="FILE_PATH")
    width: bpy.props.IntProperty(name="Width", description="Pixels of the photo")
    height: bpy.props.IntProperty(name="Height", description="Pixels of the photo")
    clicks: bpy.props.CollectionProperty(type=MGF_PG_click)

    def done(self) -> bool:
        """Tell whether the photo has a click on the building."""
        return any(not c.negative and c.part == BUILDING and not c.proposed for c in self.clicks)


def photo_image(photo: MGF_PG_photo) -> bpy.types.Image | None:
    """Return the photo as an image block, loaded on first use; None when the file is gone."""
    path = Path(bpy.path.abspath(photo.file))
    if not photo.file or not path.is_file():
        return None
    image = bpy.data.images.load(str(path), check_existing=True)
    image[IMAGE_KEY] = "photo"
    return image


def photo_of_image(scene: bpy.types.Scene, image: bpy.types.Image | None) -> int:
    """Return the index of the list's photo that an image block shows, or -1."""
    if image is None or image.source != "FILE":
        return -1
    shown = Path(bpy.path.abspath(image.filepath))
    name = os.path.normcase(shown.name)
    for i, photo in enumerate(scene.mgf.photos):
        # Drawing and every move of the pointer ask, so whole paths are compared only where the names are the same.
        alike = photo.file and os.path.normcase(photo.file).endswith(name)
        if alike and Path(bpy.path.abspath(photo.file)) == shown:
            return i
    return -1


def active_photo(scene: bpy.types.Scene) -> MGF_PG_photo | None:
    """Return the photo chosen in the list."""
    index = scene.mgf.photo_index
    return scene.mgf.photos[index] if 0 <= index < len(scene.mgf.photos) else None


def marks_control_points(scene: bpy.types.Scene) -> bool:
    """Return whether clicks mark control points and not the building; without points there is nothing to mark."""
    state = scene.mgf.georef
    return bool(state.marking and len(state.points))


def show_photo(self: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    """Show the chosen photo in the Image Editor that it was chosen in, else in those that show a photo of the list or
    nothing: others keep a texture, a drawing or a render."""
    photo = active_photo(self.id_data)
    image = photo_image(photo) if photo is not None else None
    if image is None or context.screen is None:
        return
    here = context.area if context.area is not None and context.area.type == "IMAGE_EDITOR" else None
    editors = [area for area in context.screen.areas if area.type == "IMAGE_EDITOR"]
    for area in [here] if here else [a for a in editors if _shows_photo(self.id_data, a.spaces.active.image)]:
        before = area.spaces.active.image
        area.spaces.active.image = image
        if context.window is not None and (before is None or tuple(before.size) != tuple(image.size)):
            fit_photo(context.window, area)
        area.tag_redraw()


def _shows_photo(scene: bpy.types.Scene, image: bpy.types.Image | None) -> bool:
    return image is None or photo_of_image(scene, image) >= 0
