# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials and node groups that show what the files carry: vertex colours and coloured points."""

from __future__ import annotations

import bpy

COLOR_ATTRIBUTE = "Color"
_MESH, _POINTS, _NODES = "MGF Vertex Colors", "MGF Point Colors", "MGF Points"


def vertex_color_material() -> bpy.types.Material:
    """A matte surface in the colours of the mesh, made once."""
    return _color_material(_MESH, roughness=0.85)


def part_material(name: str) -> bpy.types.Material:
    """The same surface under a part's own name, so that windows can be made glass."""
    return _color_material(f"MGF {name.title()}", roughness=0.85)


def point_color_material() -> bpy.types.Material:
    """The same for points."""
    return _color_material(_POINTS, roughness=1.0)


def _color_material(name: str, roughness: float) -> bpy.types.Material:
    material = bpy.data.materials.get(name)
    if material is not None:
        return material
    material = bpy.data.materials.new(name)
    if not material.node_tree:
        material.use_nodes = True
    tree = material.node_tree
    shader = next(n for n in tree.nodes if n.type == "BSDF_PRINCIPLED")
    shader.inputs["Roughness"].default_value = roughness
    shader.inputs["Specular IOR Level"].default_value = 0.2
    color = tree.nodes.new("ShaderNodeAttribute")
    color.attribute_name = COLOR_ATTRIBUTE
    color.location = (shader.location.x - 220, shader.location.y)
    tree.links.new(color.outputs["Color"], shader.inputs["Base Color"])
    return material


def show_points(obj: bpy.types.Object, radius: float) -> None:
    """Show the vertices of a mesh object as round points of ``radius`` in their colours."""
    modifier = obj.modifiers.new("Points", "NODES")
    modifier.node_group = _points_group(radius)


def _points_group(radius: float) -> bpy.types.NodeTree:
    """Geometry nodes: mesh -> points of one radius -> our material; one group per scene size."""
    name = f"{_NODES} {radius:.3g}"
    group = bpy.data.node_groups.get(name)
    if group is not None:
        return group
    group = bpy.data.node_groups.new(name, "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    kinds = ("NodeGroupInput", "GeometryNodeMeshToPoints", "GeometryNodeSetMaterial", "NodeGroupOutput")
    nodes = [group.nodes.new(kind) for kind in kinds]
    for i, node in enumerate(nodes):
        node.location = (200 * i, 0)
    nodes[1].inputs["Radius"].default_value = radius
    nodes[2].inputs["Material"].default_value = point_color_material()
    for a, b, socket in ((0, 1, "Mesh"), (1, 2, "Geometry"), (2, 3, "Geometry")):
        group.links.new(nodes[a].outputs[0], nodes[b].inputs[socket])
    return group
