# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials that show a texture or the vertex colours of a mesh, whichever is chosen.

The choice is made by moving links between two nodes, so that the base colour hangs on the picture itself: exporters
and other programs know that form, and what the user changed in a material stays.
"""

from __future__ import annotations

from pathlib import Path

import bpy

from .materials import MATTE, new_material

_PICTURE, _COLORS = "MGF Picture", "MGF Colors"  # the two nodes
_KEY = "mgf_texture"  # on our materials: the part they are for


def texture_material(part: str, texture: bpy.types.Image) -> bpy.types.Material:
    """Return a material that can show a texture, for one part of a mesh.

    One that an earlier import of the same job left is taken again, with what the user changed in it. One in use is
    not, because each mesh chooses for itself what it shows.
    """
    for known in bpy.data.materials:
        earlier = texture_of(known) if known.get(_KEY) == part and known.users == 0 else None
        if earlier is not None and _job_of(earlier) == _job_of(texture):
            known.node_tree.nodes[_PICTURE].image = texture
            return known
    # Materials of parts without texture are in title case, so none of them has such a name.
    material, shader = new_material(f"MGF {part.title()} (texture)", MATTE)
    material[_KEY] = part
    tree = material.node_tree
    colors = tree.nodes.new("ShaderNodeVertexColor")
    picture = add_texture_node(tree, texture)
    x, y = shader.location
    picture.name, picture.location = _PICTURE, (x - 320, y)
    colors.name, colors.location = _COLORS, (x - 320, y - 300)
    tree.links.new(picture.outputs["Color"], shader.inputs["Base Color"])
    return material


def _job_of(texture: bpy.types.Image) -> Path:
    """Return the job folder of a texture, which lies in it or in the folder of one of its runs (``runs/1``, ``runs/2``
    …)."""
    folder = Path(bpy.path.abspath(texture.filepath)).parent
    return folder.parents[1] if folder.parent.name == "runs" else folder


def add_texture_node(tree: bpy.types.NodeTree, texture: bpy.types.Image) -> bpy.types.ShaderNodeTexImage:
    """Return a node with a texture, made the active one because that is what the solid mode draws."""
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image, node.extension = texture, "EXTEND"
    tree.nodes.active = node
    return node


def texture_of(material: bpy.types.Material | None) -> bpy.types.Image | None:
    """Return the texture of one of our materials; None for others, and where the user took our nodes away."""
    if material is None or _KEY not in material or not material.node_tree:
        return None
    nodes = material.node_tree.nodes
    return nodes[_PICTURE].image if _PICTURE in nodes and _COLORS in nodes else None


def shows_texture(material: bpy.types.Material | None) -> bool:
    """Tell whether a material shows its texture and not the vertex colours."""
    return texture_of(material) is not None and material.node_tree.nodes[_PICTURE].outputs["Color"].is_linked


def show_texture(material: bpy.types.Material | None, on: bool) -> None:
    """Let what hangs on the vertex colours of a material hang on its texture, or back; other materials stay."""
    if texture_of(material) is None:
        return
    tree = material.node_tree
    picture, colors = (tree.nodes[name].outputs["Color"] for name in (_PICTURE, _COLORS))
    old, new = (colors, picture) if on else (picture, colors)
    for socket in [link.to_socket for link in old.links]:
        tree.links.new(new, socket)


def remove_unused_materials() -> None:
    """Remove the materials with a texture that nothing uses any more."""
    bpy.data.batch_remove([m for m in bpy.data.materials if _KEY in m and m.users == 0])
