# SPDX-License-Identifier: GPL-3.0-or-later
"""Read the texture of a mesh, picture and coordinates, and check it before anything in Blender changes."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from ..common.errors import UserError, reason
from ..common.textures import remove_unused_materials
from ..scene_import.cameras import IMAGE_KEY, load_image

_KIND = "texture"  # among the images of the add-on
_BEGIN, _END = b"\xff\xd8\xff", b"\xff\xd9"  # of a JPEG


def read_uv(path: Path, faces: int) -> np.ndarray:
    """Read ``mesh_texture.npz``: float32 [F, 3, 2], for each corner of each face, v upward.

    Raises:
        UserError: the file is damaged or belongs to another mesh.
    """
    try:
        with np.load(path, allow_pickle=False) as data:
            uv = data["uv"]
        if uv.dtype.kind != "f" or not np.isfinite(uv).all():
            raise ValueError("no texture coordinates")
    except Exception as error:  # a damaged archive fails in the words of zip, zlib, numpy or Python's tokenizer
        raise UserError("Cannot read '{path}' ({error}); run the job again.", path=path, error=reason(error)) from error
    if uv.shape != (faces, 3, 2):
        raise UserError("'{path}' belongs to another mesh; run the job again.", path=path)
    return uv.astype(np.float32, copy=False)


def check_picture(path: Path) -> None:
    """Make sure that a picture is a whole JPEG: Blender reads it only when it is drawn, and then says nothing.

    Raises:
        UserError: it is not.
    """
    try:
        data = path.read_bytes()
        if not data.startswith(_BEGIN) or not data.rstrip(b"\0").endswith(_END):
            raise ValueError("no whole JPEG picture")
    except (OSError, ValueError) as error:
        raise UserError("Cannot read '{path}' ({error}); run the job again.", path=path, error=reason(error)) from error


def load_texture(path: Path) -> bpy.types.Image:
    """Read the picture as an image.

    Raises:
        UserError: the file is gone.
    """
    try:
        return load_image(path, _KIND)
    except RuntimeError as error:
        raise UserError("Cannot read '{path}' ({error}); run the job again.", path=path, error=reason(error)) from error


def remove_unused_textures() -> None:
    """Remove the materials, textures and renders of earlier imports that nothing uses any more."""
    remove_unused_materials()
    ours = [i for i in bpy.data.images if i.get(IMAGE_KEY) in {_KIND, "render"}]
    # Their own count of users is not enough: a picture taken from behind a camera keeps it.
    bpy.data.batch_remove([image for image, users in bpy.data.user_map(subset=ours).items() if not users])
