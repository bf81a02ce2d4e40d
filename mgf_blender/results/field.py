# SPDX-License-Identifier: GPL-3.0-or-later
"""The Gaussian field as coloured points, for Blender versions that do not draw 3DGS files themselves."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from ..common.errors import UserError
from ..common.materials import show_points
from ..common.meshes import make_mesh, prepare_mesh
from ..common.ply import read_ply
from ..common.views import follow_paint
from ..scene_import.imported_scene import FIELD_KEY, ImportedScene, hide, is_shown

#: First band of the spherical harmonics, 1 / (2 sqrt(pi)): colour = 0.5 + SH0 * f_dc.
_SH0 = 0.28209479177387814
_SIZE = 0.004  # of a drawn point, as a share of the scene's size


def import_field(imported: ImportedScene, path: Path) -> bpy.types.Object:
    """Return the centres of a standard 3DGS ``.ply`` with colour, opacity and size as attributes.

    Raises:
        UserError: the file is no Gaussian field.
    """
    ply = read_ply(path)
    names = {"f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"}
    if not names <= set(ply.vertices):
        raise UserError("'{path}' is not a Gaussian field; choose the field.ply of a job.", path=path)
    base = np.stack([ply.vertices[f"f_dc_{i}"] for i in range(3)], axis=1)
    colors = np.clip((0.5 + _SH0 * base) * 255 + 0.5, 0, 255).astype(np.uint8)
    sizes = np.stack([ply.vertices[f"scale_{i}"] for i in range(3)], axis=1).astype(np.float32)
    values = {
        "opacity": 1.0 / (1.0 + np.exp(-ply.vertices["opacity"].astype(np.float32))),
        "size": np.exp(sizes.max(axis=1)),
    }
    mesh = make_mesh("Gaussian Field", prepare_mesh(ply.positions - imported.offset, np.zeros((0, 3)), colors, values))
    obj = bpy.data.objects.new("Gaussian Field", mesh)
    for old in [o for o in imported.objects("Points") if o.get(FIELD_KEY)]:
        bpy.data.objects.remove(old, do_unlink=True)
    imported.add("Points", obj)
    obj[FIELD_KEY] = True
    show_points(obj, _SIZE * imported.radius)
    return obj


def show_field(scene: bpy.types.Scene, imported: ImportedScene) -> None:
    """Show the field in its colours, without the mesh: most of it lies on that or inside."""
    for obj in (*imported.objects("Mesh"), *imported.objects("LODs")):
        hide(obj)
    follow_paint(scene, texture=False, lit=False)


def leave_field(scene: bpy.types.Scene, imported: ImportedScene) -> None:
    """Hide the field, where it is shown, and light the mesh again that is shown in its place."""
    fields = shown_fields(imported)
    for obj in fields:
        hide(obj)
    if fields:
        follow_paint(scene, imported.shows_texture, lit=True)


def shown_fields(imported: ImportedScene) -> list[bpy.types.Object]:
    """Return the field's object where the viewports show it."""
    return [obj for obj in imported.objects("Points") if obj.get(FIELD_KEY) and is_shown(obj)]
