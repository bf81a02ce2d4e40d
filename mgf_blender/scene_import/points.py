# SPDX-License-Identifier: GPL-3.0-or-later
"""The sparse points as one object with colour, track length and error per point."""

from __future__ import annotations

import bpy
import numpy as np

from ..common.materials import show_points
from ..common.meshes import make_mesh, prepare_mesh, vertices_of
from .colmap import Points
from .imported_scene import FIELD_KEY, ImportedScene

#: Size of a drawn point as a share of the scene's size: of many points, and of so few that they leave gaps.
_SIZE, _LARGEST, _MANY = 0.006, 0.009, 20_000


def add_points(imported: ImportedScene, points: Points, name: str = "Sparse Points") -> bpy.types.Object | None:
    """Return one mesh of loose vertices, drawn as round points; None when the model has no points."""
    if len(points.xyz) == 0:
        return None
    values = {"track_length": points.track_length, "reprojection_error": points.error}
    mesh = make_mesh(name, prepare_mesh(points.xyz - imported.offset, np.zeros((0, 3)), points.rgb, values))
    obj = bpy.data.objects.new(name, mesh)
    imported.add("Points", obj)
    share = min(_SIZE * max(1.0, _MANY / len(points.xyz)) ** 0.5, _LARGEST)
    show_points(obj, share * imported.radius)
    return obj


def sparse_points(imported: ImportedScene) -> np.ndarray:
    """Return the sparse points in the empty's frame, float64 [N, 3]; the Gaussian field, of the same kind, is none."""
    clouds = [o for o in imported.objects("Points") if o.type == "MESH" and not o.get(FIELD_KEY)]
    if not clouds:
        return np.zeros((0, 3))
    matrix = np.array(clouds[0].matrix_basis, np.float64)
    return vertices_of(clouds[0].data) @ matrix[:3, :3].T + matrix[:3, 3]
