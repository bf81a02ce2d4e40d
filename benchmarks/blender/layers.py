# SPDX-License-Identifier: GPL-3.0-or-later
"""Layers of colour with a bump that procedural materials are made of; run inside Blender only."""

from __future__ import annotations

import bpy

Color = tuple[float, float, float]


class Layers:
    """Builds one node material: colours mixed by procedural patterns, one bump chain, a principled shader."""

    def __init__(self, name: str, strength: float, roughness: float = 0.9) -> None:
        self.material = bpy.data.materials.new(name)
        self.material.use_nodes = True
        self.strength = strength
        self.tree = self.material.node_tree
        self.nodes = self.tree.nodes
        self.shader = next(n for n in self.nodes if n.type == "BSDF_PRINCIPLED")
        self.shader.inputs["Roughness"].default_value = roughness
        coordinates = self.nodes.new("ShaderNodeTexCoord")
        self.uv, self.space = coordinates.outputs["UV"], coordinates.outputs["Object"]
        self.color = None
        self.normal = None

    def contrast(self, *colors: Color) -> list[tuple[float, float, float, float]]:
        """Return the colours pulled towards (or away from) their mean by the texture strength."""
        mean = [sum(c[i] for c in colors) / len(colors) for i in range(3)]
        pulled = [[max(0.0, mean[i] + self.strength * (c[i] - mean[i])) for i in range(3)] for c in colors]
        return [(r, g, b, 1.0) for r, g, b in pulled]

    def plain(self, color: Color) -> Layers:
        node = self.nodes.new("ShaderNodeRGB")
        node.outputs[0].default_value = (*color, 1.0)
        self.color = node.outputs[0]
        return self

    def bricks(self, a: Color, b: Color, mortar: Color, width: float, height: float, gap: float, bump: float) -> Layers:
        """Return a brick bond; each brick takes a random colour between a and b."""
        node = self.nodes.new("ShaderNodeTexBrick")
        self.tree.links.new(self.uv, node.inputs["Vector"])
        colors = self.contrast(a, b, mortar)
        for key, value in zip(("Color1", "Color2", "Mortar"), colors, strict=True):
            node.inputs[key].default_value = value
        for key, size in (
            ("Scale", 1.0),
            ("Mortar Size", gap),
            ("Brick Width", width),
            ("Row Height", height),
            ("Mortar Smooth", 0.2),
        ):
            node.inputs[key].default_value = size
        self.color = node.outputs["Color"]
        return self.bump(node.outputs["Fac"], -bump)

    def waves(self, scale: float, bump: float, axis: str = "X") -> Layers:
        """Parallel ribs along one UV axis, as a bump."""
        node = self.nodes.new("ShaderNodeTexWave")
        node.bands_direction = axis
        self.tree.links.new(self.uv, node.inputs["Vector"])
        node.inputs["Scale"].default_value = scale
        return self.bump(node.outputs["Fac"], bump)

    def stains(
        self,
        a: Color,
        b: Color,
        scale: float,
        amount: float,
        low: float = 0.4,
        high: float = 0.65,
        stretch: Color = (1, 1, 1),
    ) -> Layers:
        """Multiply by patches between two tints; ``scale`` in patches per metre."""
        fac = self.noise(scale, stretch)
        ramp = self.nodes.new("ShaderNodeValToRGB")
        for element, position, color in zip(ramp.color_ramp.elements, (low, high), self.contrast(a, b), strict=True):
            element.position, element.color = position, color
        self.tree.links.new(fac, ramp.inputs[0])
        mix = self.nodes.new("ShaderNodeMix")
        mix.data_type, mix.blend_type = "RGBA", "MULTIPLY"
        mix.inputs[0].default_value = amount
        self.tree.links.new(self.color, mix.inputs[6])
        self.tree.links.new(ramp.outputs[0], mix.inputs[7])
        self.color = mix.outputs[2]
        return self

    def noise(self, scale: float, stretch: Color = (1, 1, 1)) -> bpy.types.NodeSocket:
        mapping = self.nodes.new("ShaderNodeMapping")
        mapping.inputs["Scale"].default_value = stretch
        self.tree.links.new(self.space, mapping.inputs["Vector"])
        node = self.nodes.new("ShaderNodeTexNoise")
        node.inputs["Scale"].default_value = scale
        node.inputs["Detail"].default_value = 5.0
        node.inputs["Roughness"].default_value = 0.6
        self.tree.links.new(mapping.outputs[0], node.inputs["Vector"])
        return node.outputs[0]

    def rough(self, scale: float, bump: float) -> Layers:
        return self.bump(self.noise(scale), bump)

    def bump(self, height: bpy.types.NodeSocket, distance: float) -> Layers:
        node = self.nodes.new("ShaderNodeBump")
        node.inputs["Strength"].default_value = 0.6
        node.inputs["Distance"].default_value = abs(distance)
        node.invert = distance < 0
        self.tree.links.new(height, node.inputs["Height"])
        if self.normal is not None:
            self.tree.links.new(self.normal, node.inputs["Normal"])
        self.normal = node.outputs[0]
        return self

    def done(self, metallic: float = 0.0, specular: float = 0.3) -> bpy.types.Material:
        self.shader.inputs["Metallic"].default_value = metallic
        self.shader.inputs["Specular IOR Level"].default_value = specular
        self.tree.links.new(self.color, self.shader.inputs["Base Color"])
        if self.normal is not None:
            self.tree.links.new(self.normal, self.shader.inputs["Normal"])
        return self.material
