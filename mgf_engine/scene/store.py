# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene on disk: ``scene.npz`` (cameras, points, tracks) beside the working photos in ``images/``."""

from __future__ import annotations

import io
import json
import os
import zipfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from mgf_engine.errors import BadInput
from mgf_engine.scene.images import read_info
from mgf_engine.scene.model import Lens, Scene, Similarity, View

FILE = "scene.npz"
FORMAT = 1
_ARRAYS = {
    "points": ("f8", 2), "colors": ("u1", 2), "errors": ("f4", 1), "track_start": ("i8", 1), "track_view": ("i4", 1),
    "track_uv": ("f4", 2),
}  # fmt: skip
_POSE = ("rotation", "translation")


def save_scene(scene: Scene) -> None:
    """Write ``scene.npz`` into the scene's folder at once or not at all; the photos are already there."""
    views = [{k: v for k, v in _plain(view).items() if k not in _POSE} for view in scene.views]
    head = {
        "format": FORMAT, "views": views, "roots": list(scene.roots), "held_out": list(scene.held_out),
        "scale": scene.to_normalised.scale,
    }  # fmt: skip
    arrays: dict[str, Any] = {name: getattr(scene, name) for name in _ARRAYS}
    arrays["head"] = np.frombuffer(json.dumps(head).encode(), np.uint8)
    arrays["view_rotation"] = np.array([view.rotation for view in scene.views], np.float64).reshape(-1, 3, 3)
    arrays["view_translation"] = np.array([view.translation for view in scene.views], np.float64).reshape(-1, 3)
    arrays["rotation"], arrays["translation"] = scene.to_normalised.rotation, scene.to_normalised.translation
    temporary = scene.folder / (FILE + ".part")
    with temporary.open("wb") as file:
        np.savez(file, **arrays)
    os.replace(temporary, scene.folder / FILE)


def read_scene(folder: Path) -> Scene:
    """The scene that :func:`save_scene` wrote.

    Raises:
        BadInput: the file or a working photo is missing or damaged.
    """
    try:
        data = (folder / FILE).read_bytes()
    except OSError as error:
        raise _unusable(folder, error.strerror or "cannot be read") from error
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            bad = archive.testzip()  # all sums first: a damaged header could ask for any amount of memory
        if bad is not None:
            raise ValueError(f"{bad} is damaged")
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            scene = _build(folder, {name: arrays[name] for name in arrays.files})
    except Exception as error:  # a damaged archive can fail in any of zipfile's, zlib's and numpy's ways
        raise _unusable(folder, str(error) or type(error).__name__) from error
    for view in scene.views:
        info = read_info(folder / view.file) if (folder / view.file).is_file() else None
        if info is None or (info.width, info.height) != (view.width, view.height):
            raise _unusable(folder, f"the working photo '{view.file}' is missing or of another size")
    return scene


def _plain(view: View) -> dict[str, Any]:
    return {**view.__dict__, "lens": None if view.lens is None else asdict(view.lens)}


def _build(folder: Path, arrays: dict[str, Any]) -> Scene:
    head = json.loads(arrays["head"].tobytes().decode())
    if head["format"] != FORMAT:
        raise ValueError(f"format {head['format']}")
    for name, (kind, dimensions) in _ARRAYS.items():
        if arrays[name].dtype != np.dtype(kind) or arrays[name].ndim != dimensions:
            raise ValueError(f"{name} is {arrays[name].dtype} {arrays[name].shape}")
    poses = zip(arrays["view_rotation"], arrays["view_translation"], strict=True)
    views = tuple(
        View(**{**entry, "rotation": r, "translation": t, "lens": _lens(entry["lens"])})
        for entry, (r, t) in zip(head["views"], poses, strict=True)
    )
    return Scene(
        views=views, **{name: arrays[name] for name in _ARRAYS},
        to_normalised=Similarity(head["scale"], arrays["rotation"], arrays["translation"]),
        roots=tuple(head["roots"]), held_out=tuple(head["held_out"]), folder=folder,
    )  # fmt: skip


def _lens(entry: dict[str, Any] | None) -> Lens | None:
    return None if entry is None else Lens(entry["model"], entry["width"], entry["height"], tuple(entry["params"]))


def _unusable(folder: Path, detail: str) -> BadInput:
    return BadInput(f"The scene in '{folder}' cannot be used ({detail}); run the job again in a new folder.")
