# SPDX-License-Identifier: GPL-3.0-or-later
"""Write and read a scene: ``scene.npz`` (cameras, points, tracks) beside the working photos in ``images/``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from mgf_engine.errors import BadInput
from mgf_engine.files.atomic import atomic_path
from mgf_engine.files.images import read_info
from mgf_engine.files.safe_npz import read_arrays
from mgf_engine.model.scene import Lens, Scene, Similarity, View

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
        "scale": scene.to_normalised.scale, "left_out": list(scene.left_out),
    }  # fmt: skip
    arrays: dict[str, Any] = {name: getattr(scene, name) for name in _ARRAYS}
    arrays["head"] = np.frombuffer(json.dumps(head).encode(), np.uint8)
    arrays["view_rotation"] = np.array([view.rotation for view in scene.views], np.float64).reshape(-1, 3, 3)
    arrays["view_translation"] = np.array([view.translation for view in scene.views], np.float64).reshape(-1, 3)
    arrays["rotation"], arrays["translation"] = scene.to_normalised.rotation, scene.to_normalised.translation
    with atomic_path(scene.folder / FILE) as temporary:
        np.savez(temporary, **arrays)


def read_saved_scene(folder: Path) -> Scene:
    """Read the scene that :func:`save_scene` wrote.

    Raises:
        BadInput: the file or a working photo is missing or damaged.
    """
    try:
        scene = _build(folder, read_arrays(folder / FILE))
        _check(scene)
    except OSError as error:
        raise _unusable(folder, error.strerror or "cannot be read") from error
    except Exception as error:  # the head is JSON that may hold anything
        raise _unusable(folder, str(error) or type(error).__name__) from error
    for view in scene.views:
        info = read_info(folder / view.file) if (folder / view.file).is_file() else None
        if info is None or (info.width, info.height) != (view.width, view.height):
            raise _unusable(folder, f"the working photo '{view.file}' is missing or of another size")
    return scene


def _plain(view: View) -> dict[str, Any]:
    return {**view.__dict__, "lens": None if view.lens is None else asdict(view.lens)}


def _build(folder: Path, arrays: dict[str, Any]) -> Scene:
    """Make the scene of the arrays of its file.

    Raises:
        ValueError, KeyError, TypeError: they are of another version, or damaged.
    """
    head = json.loads(arrays["head"].tobytes().decode())
    if head["format"] != FORMAT:
        raise ValueError(f"format {head['format']}")
    for name, (kind, dimensions) in _ARRAYS.items():
        if arrays[name].dtype != np.dtype(kind) or arrays[name].ndim != dimensions:
            raise ValueError(f"{name} is {arrays[name].dtype} {arrays[name].shape}")
    poses = zip(arrays["view_rotation"], arrays["view_translation"], strict=True)
    views = tuple(
        View(**{**entry, "rotation": r, "translation": t, **_optional(entry)})
        for entry, (r, t) in zip(head["views"], poses, strict=True)
    )
    return Scene(
        views=views, **{name: arrays[name] for name in _ARRAYS},
        to_normalised=Similarity(head["scale"], arrays["rotation"], arrays["translation"]),
        roots=tuple(head["roots"]), held_out=tuple(head["held_out"]), folder=folder,
        left_out=tuple(str(name) for name in head.get("left_out", ())),
    )  # fmt: skip


def _check(scene: Scene) -> None:
    """Check everything that later stages rely on without looking again.

    Raises:
        ValueError, TypeError: something is out of range.
    """
    count, points, observations = len(scene.views), len(scene.points), len(scene.track_view)
    for view in scene.views:
        parts = PurePosixPath(view.file).parts
        if len(parts) != 2 or parts[0] != "images" or parts[1] == ".." or "\\" in view.file:
            raise ValueError(f"the working photo '{view.file}' lies outside")
        sizes = (view.width, view.height, view.original_width, view.original_height)
        if not isinstance(view.name, str) or not all(type(n) is int and 0 < n < 1 << 20 for n in sizes):
            raise ValueError(f"the view '{view.name}' has no size")
        turns = (view.orientation, view.held)
        if not isinstance(view.photo, str) or not all(type(n) is int and 1 <= n <= 8 for n in turns):
            raise ValueError(f"the view '{view.name}' has no photo")
        optics, pose = (view.fx, view.fy, view.cx, view.cy), (*view.rotation.ravel(), *view.translation)
        numbers = np.array([*view.gain, *(view.gravity or ()), *optics, *pose], np.float64)
        if not np.isfinite(numbers).all() or min(view.fx, view.fy) <= 0:
            raise ValueError(f"the view '{view.name}' has an impossible camera")
    if scene.points.shape != (points, 3) or scene.colors.shape != (points, 3) or scene.errors.shape != (points,):
        raise ValueError("the points do not fit together")
    start = scene.track_start
    if len(start) != points + 1 or start[0] != 0 or start[-1] != observations or (np.diff(start) < 0).any():
        raise ValueError("the tracks do not fit together")
    if scene.track_uv.shape != (observations, 2) or not np.isfinite(scene.track_uv).all():
        raise ValueError("the observations do not fit together")
    if observations and not (0 <= int(scene.track_view.min()) <= int(scene.track_view.max()) < count):
        raise ValueError("an observation is of no view")
    if not all(type(i) is int and 0 <= i < count for i in (*scene.roots, *scene.held_out)):
        raise ValueError("a root is no view")
    frame = scene.to_normalised
    if frame.rotation.shape != (3, 3) or frame.translation.shape != (3,) or not float(frame.scale) > 0:
        raise ValueError("the frame is impossible")
    if not all(np.isfinite(a).all() for a in (scene.points, frame.rotation, frame.translation, frame.scale)):
        raise ValueError("a coordinate is not finite")


def _lens(entry: dict[str, Any] | None) -> Lens | None:
    return None if entry is None else Lens(entry["model"], entry["width"], entry["height"], tuple(entry["params"]))


def _optional(entry: dict[str, Any]) -> dict[str, Any]:
    """Return what is a class or a tuple; scenes of earlier versions have no gain and no gravity."""
    gravity = entry.get("gravity")
    return {
        "lens": _lens(entry["lens"]),
        "gain": _three(entry.get("gain", (1.0, 1.0, 1.0))),
        "gravity": None if gravity is None else _three(gravity),
    }


def _three(values: Sequence[float]) -> tuple[float, float, float]:
    first, second, third = (float(v) for v in values)
    return first, second, third


def _unusable(folder: Path, detail: str) -> BadInput:
    return BadInput(f"The scene in '{folder}' cannot be used ({detail}); run again with --resume to make it anew.")
