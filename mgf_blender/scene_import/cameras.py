# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender cameras that project exactly as COLMAP's pinhole cameras do.

Lens and shift belong to the camera, but the size of the picture and the pixel aspect belong to the scene; each
camera object therefore remembers its own, and :func:`fit_render` applies them when a camera is looked through.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from .imported_scene import ImportedScene, hide

PHOTO_KEY, SIZE_KEY, ASPECT_KEY, DISTORTED_KEY = "mgf_photo", "mgf_size", "mgf_pixel_aspect", "mgf_distorted"
HELD_KEY = "mgf_held"  # on cameras: the EXIF orientation that the photo lacks, 1 for none
SHOWN_KEY = "mgf_shown"  # on cameras: which of the pictures is shown
IMAGE_KEY = "mgf_image"  # on images: photo, render, error or texture
_SENSOR = 36.0  # mm; any value gives the same picture


@dataclass(frozen=True)
class CameraSpec:
    """One camera to make.

    Attributes:
        name: of the photo, as in the COLMAP model.
        width, height: of the picture, pixels.
        fx, fy, cx, cy: in pixels; the top-left pixel's centre is (0.5, 0.5).
        rotation, translation: ``camera = rotation @ scene + translation``, COLMAP axes, float64.
        picture: file of the photo, or None when it is not there.
        distorted: the photo has lens distortion that a Blender camera cannot show.
        held: EXIF orientation that the photo lacks, 1 for none: how the camera was held.
    """

    name: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    rotation: np.ndarray
    translation: np.ndarray
    picture: Path | None = None
    distorted: bool = False
    held: int = 1

    def object_matrix(self, offset: np.ndarray) -> np.ndarray:
        """Return the matrix [4, 4] from Blender's camera axes (y up, looking along -z) to offset scene coordinates."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.rotation.T @ np.diag([1.0, -1.0, -1.0])
        matrix[:3, 3] = -self.rotation.T @ self.translation - offset
        return matrix


def add_cameras(imported: ImportedScene, specs: Iterable[CameraSpec], kind: str = "Cameras") -> list[bpy.types.Object]:
    """Make a camera object for each spec, with its photo as background."""
    specs = list(specs)
    size = _display_size(specs, imported.radius)
    made = []
    for spec in specs:
        data = bpy.data.cameras.new(Path(spec.name).stem)
        data.display_size = size
        set_intrinsics(data, spec)
        set_clipping(data, imported)
        obj = bpy.data.objects.new(Path(spec.name).stem, data)
        obj[PHOTO_KEY] = spec.name
        obj[DISTORTED_KEY] = spec.distorted
        obj[HELD_KEY] = spec.held
        remember_size(obj, spec)
        imported.add(kind, obj, spec.object_matrix(imported.offset))
        if spec.picture is not None:
            add_background(obj, load_image(spec.picture, "photo"))
        made.append(obj)
    return made


def set_intrinsics(data: bpy.types.Camera, spec: CameraSpec) -> None:
    """Set lens and shift of a pinhole camera (exact for fx != fy and any principal point)."""
    data.sensor_fit = "HORIZONTAL"
    data.sensor_width = _SENSOR
    data.lens = spec.fx * _SENSOR / spec.width
    data.shift_x = (spec.width / 2 - spec.cx) / spec.width
    data.shift_y = (spec.cy - spec.height / 2) * (spec.fx / spec.fy) / spec.width


def remember_size(obj: bpy.types.Object, spec: CameraSpec) -> None:
    """Keep the picture's size and pixel aspect with the camera; pixel aspects below 1 are refused by Blender."""
    obj[SIZE_KEY] = [spec.width, spec.height]
    obj[ASPECT_KEY] = [max(1.0, spec.fy / spec.fx), max(1.0, spec.fx / spec.fy)]


def fit_render(scene: bpy.types.Scene, obj: bpy.types.Object) -> bool:
    """Give the scene's render the size and pixel aspect of a camera of ours; True when something changed."""
    if SIZE_KEY not in obj:
        return False
    render, (width, height), (ax, ay) = scene.render, obj[SIZE_KEY], obj[ASPECT_KEY]
    wanted = (int(width), int(height), 100, float(np.float32(ax)), float(np.float32(ay)))
    names = ("resolution_x", "resolution_y", "resolution_percentage", "pixel_aspect_x", "pixel_aspect_y")
    changed = False
    for name, value in zip(names, wanted, strict=True):
        if getattr(render, name) != value:
            setattr(render, name, value)
            changed = True
    return changed


def set_clipping(data: bpy.types.Camera, imported: ImportedScene, world_scale: float | None = None) -> None:
    """Set clip planes from the size of the scene, in world units."""
    if world_scale is None:
        world_scale = imported.root.matrix_basis.median_scale if imported.root is not None else 1.0
    data.clip_start = max(1e-6, 1e-3 * imported.radius * world_scale)
    data.clip_end = 100 * imported.radius * world_scale


def load_image(path: Path, kind: str) -> bpy.types.Image:
    """Read an image block for a file, shared with other users of the same file; pixels load when first shown.

    One that was shown already is read anew: a job may have run again since.
    """
    image = bpy.data.images.load(str(path), check_existing=True)
    if image.has_data:
        image.reload()
    image[IMAGE_KEY] = kind
    return image


def add_background(obj: bpy.types.Object, image: bpy.types.Image, show: bool = True) -> None:
    """Show a picture behind a camera, filling its frame; replaces the one of the same kind."""
    data = obj.data
    for slot in data.background_images:
        if slot.image is not None and slot.image.get(IMAGE_KEY) == image.get(IMAGE_KEY):
            data.background_images.remove(slot)
            break
    slot = data.background_images.new()
    slot.image = image
    slot.alpha = 1.0
    slot.frame_method = "STRETCH"
    slot.display_depth = "BACK"
    slot.show_background_image = show
    data.show_background_images = True


def clear_view(imported: ImportedScene, camera: bpy.types.Object) -> None:
    """Hide the render that stands in a camera's frustum, where it would cover the mesh; those of others come back."""
    for obj in imported.objects("Renders"):
        hide(obj, obj.parent == camera)


def find_source(scene: bpy.types.Scene) -> ImportedScene | None:
    """Find the imported scene whose photos a reconstruction takes, among results of other jobs; None without."""
    scenes = ImportedScene.find_all(scene)
    if len(scenes) < 2:  # panels ask at every redraw; with one scene there is no need to look at its cameras
        return scenes[0] if scenes else None
    names = {photo.name for photo in scene.mgf.photos}
    of_photos = (t for t in scenes if any(o.get(PHOTO_KEY) in names for o in t.objects("Cameras")))
    return next(of_photos, scenes[0])


def shrink_cameras(imported: ImportedScene, factor: float) -> None:
    """Draw the cameras of a scene smaller."""
    for camera in imported.objects("Cameras"):
        camera.data.display_size *= factor


def _display_size(specs: list[CameraSpec], radius: float) -> float:
    """Return frustums that do not overlap much: half the median distance to the next camera."""
    if len(specs) < 2:
        return 0.1 * radius
    centres = np.array([-s.rotation.T @ s.translation for s in specs])
    sample = centres[:: max(1, len(centres) // 200)]
    distance = np.linalg.norm(sample[:, None] - centres[None], axis=2)
    distance[distance < 1e-9] = np.inf
    nearest = distance.min(axis=1)
    nearest = nearest[np.isfinite(nearest)]
    typical = float(np.median(nearest)) if len(nearest) else 0.1 * radius
    return float(np.clip(0.5 * typical, 0.01 * radius, 0.15 * radius))
