# SPDX-License-Identifier: GPL-3.0-or-later
"""Bring a COLMAP scene into a Blender scene: what the operator, the drop handler and batch runs all call."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ..common.text import N_, tr
from .cameras import PHOTO_KEY, CameraSpec, add_cameras, fit_render
from .colmap import Model, Photo, read_model
from .exif import orientation_lacking
from .frame import make_frame, turn_as_held
from .imported_scene import ImportedScene
from .locate import find_model, find_photo, find_photo_folder
from .points import add_points
from .startup_cube import remove_startup_cube

_PLAIN_NAMES = {"0", "1", "sparse", "colmap", "dense", "images", "photos", "input"}


@dataclass(frozen=True)
class SceneImport:
    """What an import brought, for the line the user reads.

    Attributes:
        imported: the collections.
        model: as it was read.
        photo_folder: where the photos lie, or None.
        warnings: sentences worth showing.
        other: whether it took the place of a scene of other photos.
    """

    imported: ImportedScene
    model: Model
    photo_folder: Path | None
    warnings: tuple[str, ...]
    other: bool = False

    def counts(self) -> dict[str, int]:
        """Return how many cameras and points came."""
        return {"cameras": len(self.model.photos), "points": len(self.model.points.xyz)}


def import_scene(
    scene: bpy.types.Scene,
    path: Path,
    photo_folder: Path | None = None,
    upright: bool = True,
    imported: ImportedScene | None = None,
    named: Path | None = None,
) -> SceneImport:
    """Import cameras with photos and sparse points.

    Args:
        scene: to import into.
        path: a model file, a model folder or the project folder around it.
        photo_folder: where the photos lie; searched when None, or where none of them is there.
        upright: turn the scene so that the photos' up is z; False keeps the model's axes.
        imported: an earlier import to replace; its empty (and so its pose and scale) is kept, unless none of its
            photos is in this scene: then it was another one, and its mesh and all else go with it.
        named: the folder that gives the collection its name; None takes ``path``.

    Raises:
        UserError: nothing usable there; the scene is then unchanged.
    """
    path = path.absolute()
    model = read_model(find_model(path))
    names = [p.name for p in model.photos]
    if photo_folder is None or all(find_photo(photo_folder, name) is None for name in names):
        photo_folder = find_photo_folder(path, model.folder, names) or photo_folder
    specs = [_spec(p, photo_folder) for p in model.photos]
    name = _scene_name(named or (path if path.is_dir() else model.folder))
    before = set() if imported is None else {o.get(PHOTO_KEY, "") for o in imported.objects("Cameras")}
    other = bool(before) and not before & set(names)
    if imported is None or other:
        rotations = np.array([turn_as_held(s.rotation, s.held) for s in specs])
        centres = np.array([p.centre for p in model.photos])
        frame = make_frame(model.points.xyz, rotations, centres, upright)
        if imported is None:
            remove_startup_cube(scene)
            imported = ImportedScene.make(scene, name, frame)
        else:
            imported.clear_all()
            imported.place(name, frame)
    for kind in ("Cameras", "Points"):
        imported.clear(kind)
    cameras = add_cameras(imported, specs)
    add_points(imported, model.points)
    scene.camera = cameras[0]
    fit_render(scene, cameras[0])
    return SceneImport(imported, model, photo_folder, tuple(_warnings(specs)), other)


def _spec(photo: Photo, folder: Path | None) -> CameraSpec:
    camera = photo.camera
    picture = find_photo(folder, photo.name) if folder is not None else None
    return CameraSpec(
        photo.name, camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy,
        photo.rotation, photo.translation, picture, camera.distorted,
        orientation_lacking(picture, (camera.width, camera.height)),
    )  # fmt: skip


def _scene_name(folder: Path) -> str:
    """Return the folder people would call the scene by: not 'sparse', '0' or 'images'."""
    while folder.name.lower() in _PLAIN_NAMES and folder != folder.parent:
        folder = folder.parent
    return folder.name or "Building"


def _warnings(specs: list[CameraSpec]) -> list[str]:
    lines = []
    missing = sum(s.picture is None for s in specs)
    if missing:
        text = N_("{missing} of {count} photos were not found; set the photo folder and import again")
        lines.append(tr(text, missing=missing, count=len(specs)))
    if any(s.distorted for s in specs):
        lines.append(tr("The photos have lens distortion, so they match the cameras only after a reconstruction"))
    return lines
