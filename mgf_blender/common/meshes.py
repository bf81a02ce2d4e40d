# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh blocks from numpy arrays, without loops in Python and in steps short enough for a timer.

:func:`prepare_mesh` does what needs no Blender data, which an undo between two steps cannot take away.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import bpy
import numpy as np

from .materials import COLOR_ATTRIBUTE

UV_MAP = "UVMap"


@dataclass(frozen=True)
class MeshData:
    """A mesh as Blender stores it.

    Attributes:
        positions: float32 [N, 3], object coordinates.
        triangles: int32 [F, 3].
        colors: float32 [N, 4] in sRGB, 0..1, or None.
        kept: bool, one for each face given: faces whose corners coincide are left out.
        extras: name -> a value per vertex, [N].
        uv: float32 [F, 3, 2], texture coordinates of each corner, or None.
    """

    positions: np.ndarray
    triangles: np.ndarray
    colors: np.ndarray | None
    kept: np.ndarray
    extras: dict[str, np.ndarray] = field(default_factory=dict)
    uv: np.ndarray | None = None


def prepare_mesh(
    positions: np.ndarray,
    triangles: np.ndarray,
    colors: np.ndarray | None = None,
    extras: dict[str, np.ndarray] | None = None,
    uv: np.ndarray | None = None,
) -> MeshData:
    """Bring arrays into Blender's form; uses no Blender data.

    Args:
        positions: [N, 3], object coordinates.
        triangles: int [F, 3]; none makes a mesh of loose points.
        colors: uint8 [N, 3] in sRGB, or None.
        extras: name -> [N], whole numbers or floats.
        uv: [F, 3, 2], one for each corner of each face given, or None.
    """
    a, b, c = np.asarray(triangles, np.int32).reshape(-1, 3).T
    kept = (a != b) & (b != c) & (c != a)
    faces = np.ascontiguousarray(np.asarray(triangles, np.int32).reshape(-1, 3)[kept])
    rgba = None
    if colors is not None:
        rgba = np.ones((len(colors), 4), np.float32)
        rgba[:, :3] = colors.astype(np.float32) / 255.0
    places = np.nan_to_num(np.ascontiguousarray(positions, np.float32))
    corners = np.ascontiguousarray(uv[kept], np.float32) if uv is not None else None
    return MeshData(places, faces, rgba, kept, dict(extras or {}), corners)


def make_mesh(name: str, data: MeshData, sharp_degrees: float | None = None) -> bpy.types.Mesh:
    """Make a mesh block, see :func:`mesh_steps`."""
    mesh = bpy.data.meshes.new(name)
    for _ in mesh_steps(mesh.name, data, sharp_degrees):
        pass
    return mesh


def mesh_steps(name: str, data: MeshData, sharp_degrees: float | None = None) -> Iterator[None]:
    """Fill the empty mesh block ``name``, yielding after each step; it is looked up anew for each.

    Args:
        sharp_degrees: edges where the surface turns by more become sharp, all else is shaded smooth.

    Raises:
        KeyError: the block is gone, for example after an undo.
    """
    mesh = bpy.data.meshes[name]
    mesh.vertices.add(len(data.positions))
    mesh.attributes["position"].data.foreach_set("vector", data.positions.ravel())
    if len(data.triangles):
        yield
        yield from _faces(name, data)
        yield
        bpy.data.meshes[name].update(calc_edges=True)
    if data.colors is not None:
        yield
        set_colors(bpy.data.meshes[name], data.colors)
    for key, values in data.extras.items():
        yield
        set_attribute(bpy.data.meshes[name], key, values)
    if data.uv is not None:
        yield
        layer = bpy.data.meshes[name].uv_layers.new(name=UV_MAP, do_init=False)
        layer.uv.foreach_set("vector", data.uv.ravel())
    yield
    mesh = bpy.data.meshes[name]
    if sharp_degrees is not None and len(data.triangles):
        mesh.set_sharp_from_angle(angle=math.radians(sharp_degrees))
        yield
    bpy.data.meshes[name].update()


def _faces(name: str, data: MeshData) -> Iterator[None]:
    mesh, count = bpy.data.meshes[name], len(data.triangles)
    mesh.loops.add(3 * count)
    mesh.attributes[".corner_vert"].data.foreach_set("value", data.triangles.ravel())
    yield
    mesh = bpy.data.meshes[name]
    mesh.polygons.add(count)
    mesh.polygons.foreach_set("loop_start", np.arange(0, 3 * count, 3, dtype=np.int32))


def vertices_of(mesh: bpy.types.Mesh) -> np.ndarray:
    """Return the vertices of a mesh in its own coordinates, float32 [N, 3]."""
    flat = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", flat)
    return flat.reshape(-1, 3)


def set_colors(mesh: bpy.types.Mesh, rgba: np.ndarray, name: str = COLOR_ATTRIBUTE) -> None:
    """Set vertex colours, float32 [N, 4] in sRGB, as the mesh's active colour attribute."""
    layer = mesh.attributes.get(name) or mesh.attributes.new(name, "BYTE_COLOR", "POINT")
    layer.data.foreach_set("color_srgb", np.ascontiguousarray(rgba, np.float32).ravel())
    choose_colors(mesh, name)


def choose_colors(mesh: bpy.types.Mesh, name: str) -> None:
    """Draw and render a mesh in one of its colour attributes."""
    layers = mesh.color_attributes
    layers.active_color = layers[name]
    layers.render_color_index = layers.find(name)


def set_attribute(mesh: bpy.types.Mesh, name: str, values: np.ndarray) -> None:
    """Set a named value per vertex: whole numbers or floats, [N]."""
    kind, dtype = ("INT", np.int32) if values.dtype.kind in "iu" else ("FLOAT", np.float32)
    layer = mesh.attributes.new(name, kind, "POINT")
    layer.data.foreach_set("value", np.ascontiguousarray(values, dtype))
