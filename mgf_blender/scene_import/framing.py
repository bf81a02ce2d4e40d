# SPDX-License-Identifier: GPL-3.0-or-later
"""Turn the 3D viewports to an imported scene, or to one object of it, from the side that the photos show."""

import bpy
import numpy as np

from ..common.views import frame_scene, side_of_cameras
from .imported_scene import ImportedScene
from .points import sparse_points


def frame_imported(context: bpy.types.Context, imported: ImportedScene) -> None:
    """Turn the viewports to an imported scene; points are drawn in the colours of the photos until there is a mesh."""
    root = imported.root
    points = sparse_points(imported)
    middle = np.median(points, axis=0) if len(points) else np.zeros(3)
    matrix = np.array(root.matrix_basis)
    middle = matrix[:3, :3] @ middle + matrix[:3, 3]
    side = side_of_cameras(middle, _centres(imported))
    reach = imported.radius * root.matrix_basis.median_scale
    frame_scene(context, middle, reach, imported.shows_texture, side, lit=bool(imported.objects("Mesh")))


def _centres(imported: ImportedScene) -> np.ndarray:
    """Return where the cameras are, [N, 3], world."""
    root = np.array(imported.root.matrix_basis)
    places = np.array([np.array(o.matrix_basis)[:3, 3] for o in imported.objects("Cameras")]).reshape(-1, 3)
    return places @ root[:3, :3].T + root[:3, 3]


def frame_object(context: bpy.types.Context, obj: bpy.types.Object, imported: ImportedScene) -> None:
    """Turn the viewports to an object of a scene that fills less of it than the cameras do."""
    corners = np.array(obj.bound_box)
    # Fresh objects have no world matrices yet.
    matrix = np.array(imported.root.matrix_basis @ obj.matrix_parent_inverse @ obj.matrix_basis)
    corners = corners @ matrix[:3, :3].T + matrix[:3, 3]
    low, high = corners.min(axis=0), corners.max(axis=0)
    middle = (low + high) / 2
    side = side_of_cameras(middle, _centres(imported))
    frame_scene(context, middle, float(np.linalg.norm(high - low)) / 2, imported.shows_texture, side)
