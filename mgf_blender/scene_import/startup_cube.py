# SPDX-License-Identifier: GPL-3.0-or-later
"""The cube of Blender's startup file, which would stand in the middle of the imported building."""

import bpy
import numpy as np
from mathutils import Matrix

_NAME = "Cube"
_MATERIALS = {"Material"}


def remove_startup_cube(scene: bpy.types.Scene) -> None:
    """Remove the cube of Blender's startup file from a scene, where it is as it came and the file was never saved."""
    cube = scene.objects.get(_NAME)
    if cube is not None and not bpy.data.filepath and _is_untouched(cube):
        bpy.data.batch_remove([cube, cube.data])


def _is_untouched(cube: bpy.types.Object) -> bool:
    """Tell whether an object is two metres wide, at the origin, and nothing was made of it or for it."""
    mesh = cube.data
    if cube.library or cube.type != "MESH" or mesh.users > 1 or mesh.shape_keys is not None or len(mesh.vertices) != 8:
        return False
    used = cube.parent or cube.children or cube.modifiers or cube.constraints or cube.animation_data or cube.keys()
    if used or cube.mode != "OBJECT" or not {m.name for m in mesh.materials if m is not None} <= _MATERIALS:
        return False
    places = np.empty(24, np.float32)
    mesh.vertices.foreach_get("co", places)
    return len(mesh.polygons) == 6 and cube.matrix_world == Matrix() and bool((np.abs(places) == 1).all())
