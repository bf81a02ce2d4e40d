# SPDX-License-Identifier: GPL-3.0-or-later
"""The crop box: an empty drawn as a cube under the scene's own empty; only what lies in it is meshed.

Moving, turning and scaling it is done with Blender's own tools; the engine gets its matrix in scene coordinates.
"""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix

from .imported_scene import CROP, ROLE_KEY, ImportedScene, objects_below
from .points import sparse_points

_NAME = "Crop Box"
#: Shares of the points that the first box leaves out at each end of each axis, and how much it is made larger.
_OUTLIERS, _MARGIN = 2.0, 1.1


def find_crop_box(imported: ImportedScene | None) -> bpy.types.Object | None:
    """Find the crop box of an imported scene."""
    if imported is None:
        return None
    return next((o for o in objects_below(imported.collection) if o.get(ROLE_KEY) == CROP), None)


def add_crop_box(imported: ImportedScene) -> bpy.types.Object:
    """Return a box around the sparse points, level with the world; the one that is there is fitted anew."""
    from_world, box = imported.from_world(), find_crop_box(imported)
    if box is None:
        box = bpy.data.objects.new(_NAME, None)
        box[ROLE_KEY] = CROP
        box.empty_display_type = "CUBE"
        box.empty_display_size = 1.0
        imported.collection.objects.link(box)
        box.parent = imported.root
    root = np.array(imported.root.matrix_world)
    points = _points(imported) @ root[:3, :3].T + root[:3, 3]
    low, high = np.percentile(points, [_OUTLIERS, 100 - _OUTLIERS], axis=0)
    half = np.maximum((high - low) / 2 * _MARGIN, 1e-6)
    matrix = np.diag([*half, 1.0])
    matrix[:3, 3] = (low + high) / 2
    box.matrix_parent_inverse = Matrix.Identity(4)
    box.matrix_basis = Matrix((from_world @ matrix).tolist())
    return box


def crop_text(imported: ImportedScene | None) -> str:
    """Write the box as the engine's option ``crop_box``: the matrix cube -> scene, row by row; empty without a box."""
    box = find_crop_box(imported)
    if box is None or imported is None or imported.root is None:
        return ""
    matrix = imported.from_world() @ np.array(box.matrix_world, np.float64)
    matrix[:3, 3] += imported.offset
    matrix[3] = 0, 0, 0, 1
    return " ".join(f"{v:.12g}" for v in matrix.ravel())


def _points(imported: ImportedScene) -> np.ndarray:
    """Return the sparse points in the empty's frame [N, 3]; without any, a cube of the scene's size."""
    points = sparse_points(imported)
    return points if len(points) else imported.radius * np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
