# SPDX-License-Identifier: GPL-3.0-or-later
"""Choose what a camera shows: its photo, the render, the error between them, or the mesh in front of the photo."""

from __future__ import annotations

import os
from pathlib import Path

import bpy
import numpy as np

from ..common.errors import UserError
from ..scene_import.cameras import IMAGE_KEY, SHOWN_KEY, add_background, clear_view
from ..scene_import.imported_scene import ImportedScene, hide
from .surface import ramp

KINDS = ("PHOTO", "RENDER", "ERROR", "MESH")
#: Difference of colour (0..1) that is drawn in the hottest colour.
_HOTTEST = 0.3
_STAMP_KEY = "mgf_made_of"  # on error maps
#: Black, violet, orange, white.
_HEAT = np.array([(0.0, 0.0, 0.05), (0.35, 0.05, 0.45), (0.9, 0.35, 0.15), (1.0, 1.0, 0.75)])


def show(imported: ImportedScene, camera: bpy.types.Object, kind: str) -> None:
    """Show one kind of picture in a camera; the others stay attached, hidden.

    Raises:
        UserError: the camera has no such picture.
    """
    slots = list(camera.data.background_images)
    kinds = {s.image.get(IMAGE_KEY): s for s in slots if s.image is not None}
    if kind == "ERROR" and not _is_fresh(kinds):
        make_error_map(camera)
        slots = list(camera.data.background_images)
    elif kind == "RENDER" and "render" not in kinds:
        raise UserError(
            "'{name}' has no render; held-out photos get renders, others when Render All is on.", name=camera.name
        )
    elif kind == "PHOTO" and "photo" not in kinds:
        raise UserError("'{name}' has no photo; set the photo folder and import again.", name=camera.name)
    wanted = "photo" if kind == "MESH" else kind.lower()
    for slot in slots:
        slot.show_background_image = slot.image is not None and slot.image.get(IMAGE_KEY) == wanted
        slot.display_depth = "BACK" if kind == "MESH" else "FRONT"
    for obj in imported.objects("Mesh"):
        hide(obj, kind != "MESH")  # renders are clear where there is no building
    for level in imported.objects("LODs"):
        hide(level)  # the finest lies on the mesh
    clear_view(imported, camera)
    camera[SHOWN_KEY] = kind


def follow(imported: ImportedScene, camera: bpy.types.Object) -> None:
    """Show in another camera what the user chose last, or its photo where it has no such picture."""
    wanted, there = imported.root.get(SHOWN_KEY), available(camera)
    if wanted is not None:
        show(imported, camera, next(kind for kind in (wanted, "PHOTO", "MESH") if kind in there))


def available(camera: bpy.types.Object) -> set[str]:
    """Return the kinds of pictures a camera can show."""
    found = {s.image.get(IMAGE_KEY) for s in camera.data.background_images if s.image is not None}
    kinds = {"MESH"} | {kind for kind in ("PHOTO", "RENDER") if kind.lower() in found}
    return kinds | ({"ERROR"} if {"photo", "render"} <= found or "error" in found else set())


def forget_results(imported: ImportedScene) -> None:
    """Take renders and error maps off the cameras, which show the mesh before their photos again."""
    for camera in imported.objects("Cameras"):
        slots = camera.data.background_images
        for slot in [s for s in slots if s.image is not None and s.image.get(IMAGE_KEY) in {"render", "error"}]:
            slots.remove(slot)
        for slot in slots:
            slot.show_background_image, slot.display_depth = True, "BACK"
        camera.pop(SHOWN_KEY, None)
    imported.root.pop(SHOWN_KEY, None)


def _is_fresh(kinds: dict[str, bpy.types.CameraBackgroundImage]) -> bool:
    """Tell whether a camera has an error map, made of the photo and the render as they are on disk now; without them,
    one that was made is all there is."""
    if "error" not in kinds:
        return False
    stamp = _stamp({kind: slot.image for kind, slot in kinds.items()})
    return not stamp or kinds["error"].image.get(_STAMP_KEY) == stamp


def _stamp(images: dict[str, bpy.types.Image]) -> str:
    """Return what tells the files of a photo and its render from those of another run; empty when one is not there."""
    try:
        paths = [bpy.path.abspath(images[kind].filepath) for kind in ("photo", "render")]
        return " ".join(f"{path} {os.stat(path).st_mtime_ns} {os.stat(path).st_size}" for path in paths)
    except (OSError, KeyError):
        return ""


def make_error_map(camera: bpy.types.Object) -> bpy.types.Image:
    """Make a heat map of the colour difference between photo and render, as an image packed into the file.

    Raises:
        UserError: the camera has no render or no photo.
    """
    found = {s.image.get(IMAGE_KEY): s.image for s in camera.data.background_images if s.image is not None}
    if not {"photo", "render"} <= set(found):
        raise UserError(
            "'{name}' has no render to compare with its photo; enable Render All and run the job again.",
            name=camera.name,
        )
    if found["render"].has_data and not found["render"].is_dirty:
        found["render"].reload()  # the job may have run again since it was shown
    rgba = _heat_map(_pixels(found["photo"]), _pixels(found["render"]))
    height, width = rgba.shape[:2]
    name = f"Error {Path(found['photo'].name).stem}"
    image = bpy.data.images.get(name)
    if image is None or tuple(image.size) != (width, height):
        image = bpy.data.images.new(name, width, height, alpha=True)
    image.pixels.foreach_set(rgba.ravel())
    image.update()
    image.pack()
    image[IMAGE_KEY] = "error"
    image[_STAMP_KEY] = _stamp(found)
    add_background(camera, image, show=False)
    return image


def _heat_map(photo: np.ndarray, render: np.ndarray) -> np.ndarray:
    """Return the colour difference between a photo and its render [H, W, C] as a heat map, float32 [H, W, 4]; clear
    where the render is."""
    height, width = render.shape[:2]
    difference = np.abs(_resized(photo, width, height)[..., :3] - render[..., :3]).mean(axis=2)
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :3] = ramp(np.clip(difference / _HOTTEST, 0, 1), _HEAT)
    if render.shape[2] == 4:
        rgba[..., 3] = render[..., 3]
    return rgba


def _pixels(image: bpy.types.Image) -> np.ndarray:
    """Return float32 [H, W, C], first row at the bottom.

    Raises:
        UserError: the file of the image is gone.
    """
    width, height = image.size
    if width == 0 or height == 0:
        raise UserError("The picture '{name}' cannot be read; it was moved or deleted.", name=image.name)
    flat = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(flat)
    return flat.reshape(height, width, image.channels)


def _resized(pixels: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return the mean over the source pixels of each target pixel (box filter)."""
    if pixels.shape[:2] == (height, width):
        return pixels
    rows = (np.arange(height + 1) * pixels.shape[0] / height).astype(int)
    columns = (np.arange(width + 1) * pixels.shape[1] / width).astype(int)
    total = np.zeros((pixels.shape[0] + 1, pixels.shape[1] + 1, pixels.shape[2]))
    total[1:, 1:] = pixels.astype(np.float64).cumsum(0).cumsum(1)
    r0, r1 = rows[:-1], np.maximum(rows[1:], rows[:-1] + 1)
    c0, c1 = columns[:-1], np.maximum(columns[1:], columns[:-1] + 1)
    box = total[r1][:, c1] - total[r0][:, c1] - total[r1][:, c0] + total[r0][:, c0]
    return (box / ((r1 - r0)[:, None] * (c1 - c0)[None])[..., None]).astype(np.float32)
