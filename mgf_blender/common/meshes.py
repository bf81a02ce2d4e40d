# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh blocks from numpy arrays, without loops in Python."""

from __future__ import annotations

import math

import bpy
import numpy as np

from .materials import COLOR_ATTRIBUTE


def make_mesh(name: str, positions: np.ndarray, triangles: np.ndarray, colors: np.ndarray | None) -> bpy.types.Mesh:
    """A mesh of triangles, or of loose points when there are none.

    Args:
        positions: [N, 3], object coordinates.
        triangles: int32 [F, 3].
        colors: uint8 [N, 3] in sRGB, or None.
    """
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(positions))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(positions, np.float32).ravel())
    if len(triangles):
        mesh.loops.add(3 * len(triangles))
        mesh.loops.foreach_set("vertex_index", np.ascontiguousarray(triangles, np.int32).ravel())
        mesh.polygons.add(len(triangles))
        mesh.polygons.foreach_set("loop_start", np.arange(0, 3 * len(triangles), 3, dtype=np.int32))
        mesh.polygons.foreach_set("loop_total", np.full(len(triangles), 3, np.int32))
    if colors is not None:
        set_colors(mesh, colors)
    mesh.update(calc_edges=True)
    mesh.validate()
    return mesh


def set_colors(mesh: bpy.types.Mesh, colors: np.ndarray) -> None:
    """Vertex colours, uint8 [N, 3] in sRGB, as the mesh's active colour attribute."""
    layer = mesh.attributes.new(COLOR_ATTRIBUTE, "BYTE_COLOR", "POINT")
    rgba = np.ones((len(colors), 4), np.float32)
    rgba[:, :3] = colors.astype(np.float32) / 255.0
    layer.data.foreach_set("color_srgb", rgba.ravel())
    mesh.color_attributes.active_color = mesh.color_attributes[COLOR_ATTRIBUTE]


def set_attribute(mesh: bpy.types.Mesh, name: str, values: np.ndarray) -> None:
    """A named value per vertex: whole numbers or floats, [N]."""
    kind, dtype = ("INT", np.int32) if values.dtype.kind in "iu" else ("FLOAT", np.float32)
    layer = mesh.attributes.new(name, kind, "POINT")
    layer.data.foreach_set("value", np.ascontiguousarray(values, dtype))


def shade_smooth_by_angle(mesh: bpy.types.Mesh, degrees: float = 40.0) -> None:
    """Smooth faces with sharp edges where the surface turns by more than ``degrees``."""
    mesh.polygons.foreach_set("use_smooth", np.ones(len(mesh.polygons), bool))
    mesh.set_sharp_from_angle(angle=math.radians(degrees))
    mesh.update()
