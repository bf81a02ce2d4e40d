# SPDX-License-Identifier: GPL-3.0-or-later
"""The parts the user named (window, door, ...) as material slots of the mesh."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ..common.errors import UserError, reason
from ..common.materials import part_material
from ..common.textures import texture_material


@dataclass(frozen=True)
class Parts:
    """Names of the parts, the first for everything else, and the part of each face, [F]."""

    names: list[str]
    face: np.ndarray


def read_parts(path: Path, faces: int) -> Parts:
    """Read ``mesh_parts.npz``.

    Raises:
        UserError: the file is damaged or belongs to another mesh.
    """
    try:
        with np.load(path, allow_pickle=False) as data:
            names, face = data["names"], data["face"]
        if names.ndim != 1 or face.dtype.kind not in "iu":
            raise ValueError("no names and numbers of parts")
        parts = Parts([str(n) for n in names], face.astype(np.int32))
    except Exception as error:  # a damaged archive fails in the words of zip, zlib, numpy or Python's tokenizer
        raise UserError("Cannot read '{path}' ({error}); run the job again.", path=path, error=reason(error)) from error
    if parts.face.shape != (faces,) or (faces and not 0 <= parts.face.min() <= parts.face.max() < len(parts.names)):
        raise UserError("'{path}' belongs to another mesh; run the job again.", path=path)
    return parts


def assign_parts(mesh: bpy.types.Mesh, parts: Parts, texture: bpy.types.Image | None = None) -> None:
    """Assign a material slot per part that has faces; the first slot, which the mesh has already, holds the rest.

    Args:
        texture: of the mesh, which the parts show as well.
    """
    slots = np.zeros(len(parts.names), np.int32)
    for i, name in enumerate(parts.names):
        if i > 0 and (parts.face == i).any():
            slots[i] = len(mesh.materials)
            mesh.materials.append(part_material(name) if texture is None else texture_material(name, texture))
    mesh.polygons.foreach_set("material_index", slots[parts.face])
    mesh.update()
