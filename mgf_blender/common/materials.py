# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials and node groups that show what the files carry: vertex colours and coloured points."""

from __future__ import annotations

import bpy

COLOR_ATTRIBUTE = "Color"
_MESH, _POINTS, _NODES = "MGF Vertex Colors", "MGF Point Colors", "MGF Points"
_MOST_CUBES = 200_000
MATTE = 0.85  # roughness of a building


def vertex_color_material() -> bpy.types.Material:
    """Return a matte surface in the colours of the mesh, made once."""
    return _color_material(_MESH, MATTE)


def part_material(name: str) -> bpy.types.Material:
    """Return the same surface under a part's own name, so that windows can be made glass."""
    return _color_material(f"MGF {name.title()}", MATTE)


def point_color_material() -> bpy.types.Material:
    """Return the same for points."""
    return _color_material(_POINTS, roughness=1.0, attribute=COLOR_ATTRIBUTE)


def _color_material(name: str, roughness: float, attribute: str = "") -> bpy.types.Material:
    """Return a material in the colours of ``attribute``, or of whichever colour attribute the mesh chooses for
    renders."""
    material = bpy.data.materials.get(name)
    if material is not None:
        return material
    material, shader = new_material(name, roughness)
    tree = material.node_tree
    color = tree.nodes.new("ShaderNodeAttribute" if attribute else "ShaderNodeVertexColor")
    if attribute:
        color.attribute_name = attribute
    color.location = (shader.location.x - 220, shader.location.y)
    tree.links.new(color.outputs["Color"], shader.inputs["Base Color"])
    return material


def new_material(name: str, roughness: float, specular: float = 0.2) -> tuple[bpy.types.Material, bpy.types.ShaderNode]:
    """Return a material with little shine, and its shader node."""
    material = bpy.data.materials.new(name)
    if not material.node_tree:
        material.use_nodes = True
    shader = next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    shader.inputs["Roughness"].default_value = roughness
    shader.inputs["Specular IOR Level"].default_value = specular
    return material, shader


def show_points(obj: bpy.types.Object, size: float) -> None:
    """Show the vertices of a mesh object as specks of ``size`` in their colours."""
    modifier = obj.modifiers.new("Points", "NODES")
    modifier.node_group = _points_group(size, cubes=len(obj.data.vertices) <= _MOST_CUBES)


def _points_group(size: float, cubes: bool) -> bpy.types.NodeTree:
    """Return geometry nodes that draw points, one group per size and kind.

    Small cubes are the one thing that every viewport mode and renderer draws in the vertex colours. The bare points
    are joined in first, because the active colour attribute is taken from the first mesh. Beyond a few hundred
    thousand points Blender's own round points are lighter, though the Solid mode draws those without colour.
    """
    name = f"{_NODES} {size:.3g}" + ("" if cubes else " Round")
    group = bpy.data.node_groups.get(name)
    if group is not None:
        return group
    group = bpy.data.node_groups.new(name, "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    bare, end = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    specks = (_cubes if cubes else _round)(group, bare.outputs[0], size)
    paint = group.nodes.new("GeometryNodeSetMaterial")
    paint.inputs["Material"].default_value = point_color_material()
    group.links.new(specks, paint.inputs["Geometry"])
    group.links.new(paint.outputs[0], end.inputs[0])
    for i, node in enumerate(group.nodes):
        node.location = (200 * i, 0)
    return group


def _cubes(group: bpy.types.NodeTree, points: bpy.types.NodeSocket, size: float) -> bpy.types.NodeSocket:
    kinds = ("GeometryNodeMeshCube", "GeometryNodeInstanceOnPoints", "GeometryNodeJoinGeometry",
             "GeometryNodeRealizeInstances")  # fmt: skip
    cube, spread, join, real = (group.nodes.new(kind) for kind in kinds)
    cube.inputs["Size"].default_value = (size,) * 3
    group.links.new(points, spread.inputs["Points"])
    group.links.new(cube.outputs["Mesh"], spread.inputs["Instance"])
    group.links.new(spread.outputs[0], join.inputs[0])
    group.links.new(points, join.inputs[0])  # linked last, so it comes first
    group.links.new(join.outputs[0], real.inputs[0])
    return real.outputs[0]


def _round(group: bpy.types.NodeTree, points: bpy.types.NodeSocket, size: float) -> bpy.types.NodeSocket:
    node = group.nodes.new("GeometryNodeMeshToPoints")
    node.inputs["Radius"].default_value = size / 2
    group.links.new(points, node.inputs["Mesh"])
    return node.outputs[0]
