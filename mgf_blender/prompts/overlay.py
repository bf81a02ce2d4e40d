# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine's mask of a photo as a coloured overlay."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..common.json_cache import JsonCache
from . import files, preview

_UNKNOWN = 255
_BUILDING, _EDGE, _DOUBT = (1.0, 0.55, 0.1, 0.8), (1.0, 0.95, 0.4, 1.0), (0.4, 0.4, 0.4, 0.6)
_textures: dict[str, tuple[int, Any]] = {}  # picture -> (its time, texture)
_scores = JsonCache(
    lambda path, data: {v["name"]: {**v, "labels": str(path.parent / v["labels"])} for v in data["views"]}
)
_clicks = JsonCache(lambda path, data: dict(data))  # prompts.json of a job


def mask_entry(scene: bpy.types.Scene, name: str) -> dict[str, Any] | None:
    """Return what the job says about a photo's mask: ``labels`` (file), ``score``, ``used``, ``flag``; None without
    one."""
    if not scene.mgf.job_folder:
        return None
    entries = _scores.get(Path(bpy.path.abspath(scene.mgf.job_folder)) / "masks" / "scores.json")
    return None if entries is None else entries.get(name)


def mask_rgba(path: Path, binary: bool = False) -> np.ndarray:
    """Return the overlay of a label PNG: float32 [H, W, 4], first row at the bottom, as Blender's textures are.

    Args:
        binary: for a preview, which holds 255 on the building and 0 elsewhere.
    """
    image = bpy.data.images.load(str(path))
    try:
        image.colorspace_settings.name = "Non-Color"
        width, height = image.size
        pixels = np.empty(width * height * image.channels, np.float32)
        image.pixels.foreach_get(pixels)
        labels = np.rint(pixels.reshape(height, width, -1)[..., 0] * 255).astype(np.uint8)
    finally:
        bpy.data.images.remove(image)
    return paint((labels > 127).astype(np.uint8) if binary else labels)


def paint(labels: np.ndarray) -> np.ndarray:
    """Return colours for labels [H, W]: building, its outline and element borders, and doubtful pixels."""
    rgba = np.zeros((*labels.shape, 4), np.float32)
    inside = (labels > 0) & (labels != _UNKNOWN)
    rgba[inside] = _BUILDING
    rgba[labels == _UNKNOWN] = _DOUBT
    edge = np.zeros(labels.shape, bool)
    edge[:, 1:] |= labels[:, 1:] != labels[:, :-1]
    edge[1:] |= labels[1:] != labels[:-1]
    rgba[edge] = _EDGE
    return rgba


def draw(scene: bpy.types.Scene, photo: bpy.types.PropertyGroup, view: bpy.types.View2D) -> None:
    """Draw the newest mask of a photo over it: a preview, or the job's."""
    found = newest_mask(scene, photo)
    texture = _texture(*found) if found is not None else None
    if texture is None:
        return
    import gpu
    from gpu_extras.batch import batch_for_shader

    x0, y0 = view.view_to_region(0, 0, clip=False)
    x1, y1 = view.view_to_region(1, 1, clip=False)
    shader = gpu.shader.from_builtin("IMAGE_COLOR")
    corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    batch = batch_for_shader(
        shader, "TRIS", {"pos": corners, "texCoord": [(0, 0), (1, 0), (1, 1), (0, 1)]}, indices=[(0, 1, 2), (0, 2, 3)]
    )
    gpu.state.blend_set("ALPHA")
    shader.bind()
    shader.uniform_sampler("image", texture)
    shader.uniform_float("color", (1.0, 1.0, 1.0, scene.mgf.mask_opacity))
    batch.draw(shader)
    gpu.state.blend_set("NONE")


def newest_mask(scene: bpy.types.Scene, photo: bpy.types.PropertyGroup) -> tuple[Path, bool] | None:
    """Return the picture of a photo's newest mask and whether it is a preview.

    A preview of other clicks than the present ones counts only until the next one is there, or where there is nothing
    else and some of its clicks are still there; what the job made of the present clicks of all photos is better than
    any preview.
    """
    entry, shown = mask_entry(scene, photo.name), preview.finished(scene, photo.name)
    if shown is not None and not preview.under_way(scene, photo.name) and not preview.shares_clicks(shown, photo):
        shown = None
    if entry is None:
        return (shown.mask, True) if shown is not None and shown.mask.is_file() else None
    labels = Path(entry["labels"])
    fits = shown is not None and (shown.clicks == preview.signature(photo) or preview.under_way(scene, photo.name))
    if shown is not None and fits and not job_knows(scene, photo):
        try:
            if shown.mask.stat().st_mtime_ns >= labels.stat().st_mtime_ns:
                return shown.mask, True
        except OSError:
            pass
    return labels, False


def job_knows(scene: bpy.types.Scene, photo: bpy.types.PropertyGroup) -> bool:
    """Tell whether the job's mask of a photo was made from the clicks that are on it now."""
    if mask_entry(scene, photo.name) is None:
        return False
    clicks = _clicks.get(Path(bpy.path.abspath(scene.mgf.job_folder)) / "prompts.json")
    return clicks is not None and bool(clicks.get(photo.name) == files.to_data(scene, photo.name).get(photo.name))


def forget() -> None:
    """Drop the textures and what files say."""
    for store in (_textures, _scores, _clicks):
        store.clear()


def _texture(path: Path, binary: bool) -> Any:
    import gpu

    try:
        changed = path.stat().st_mtime_ns
    except OSError:
        return None
    cached = _textures.get(str(path))
    if cached is None or cached[0] != changed:
        rgba = mask_rgba(path, binary)
        height, width = rgba.shape[:2]
        buffer = gpu.types.Buffer("FLOAT", width * height * 4, np.ascontiguousarray(rgba).ravel())
        if len(_textures) > 8:
            _textures.clear()
        _textures[str(path)] = (changed, gpu.types.GPUTexture((width, height), format="RGBA8", data=buffer))
    return _textures[str(path)][1]
