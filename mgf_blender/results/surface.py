# SPDX-License-Identifier: GPL-3.0-or-later
"""Choose the colours of a mesh: texture, vertex colours, confidence, or number of photos."""

from __future__ import annotations

import bpy
import numpy as np

from ..common.errors import UserError
from ..common.materials import COLOR_ATTRIBUTE
from ..common.meshes import UV_MAP, choose_colors, set_colors
from ..common.text import tr
from ..common.textures import show_texture, shows_texture, texture_of

#: Kind -> the colour attribute that shows it and the value per vertex it is made from.
KINDS = {
    "TEXTURE": (UV_MAP, ""),
    "COLOR": (COLOR_ATTRIBUTE, ""),
    "CONFIDENCE": ("Confidence Colors", "confidence"),
    "VIEWS": ("Views Colors", "views"),
}
_TOP = 98.0  # percentile of the views that is drawn in the brightest colour
#: Dark violet, blue, green, yellow: even steps of lightness, told apart with any kind of colour vision.
_STOPS = np.array([(0.27, 0.0, 0.33), (0.23, 0.32, 0.55), (0.13, 0.57, 0.55), (0.37, 0.79, 0.38), (0.99, 0.91, 0.15)])


def available(mesh: bpy.types.Mesh) -> list[str]:
    """Return the kinds a mesh carries values for, in the order of :data:`KINDS`."""
    kinds = [kind for kind, (layer, value) in KINDS.items() if (value or layer) in mesh.attributes]
    return [kind for kind in kinds if kind != "TEXTURE" or texture(mesh) is not None]


def texture(mesh: bpy.types.Mesh) -> bpy.types.Image | None:
    """Return the texture that came with a mesh; pictures in the user's own materials are none."""
    return next((image for image in map(texture_of, mesh.materials) if image is not None), None)


def shown(mesh: bpy.types.Mesh) -> str:
    """Return the kind a mesh is painted with now; empty when it is none of ours."""
    if any(map(shows_texture, mesh.materials)):
        return "TEXTURE"
    active = mesh.color_attributes.active_color
    return next((kind for kind, (layer, _) in KINDS.items() if active is not None and active.name == layer), "")


def show(mesh: bpy.types.Mesh, kind: str) -> None:
    """Paint a mesh, in the viewport and in renders.

    Raises:
        UserError: the mesh carries no such value, or none in Edit Mode.
    """
    if kind not in available(mesh):
        if kind == "TEXTURE":
            raise UserError("The mesh has no texture; enable the option Texture and run the job again.")
        raise UserError(
            "The mesh carries no {kind}; run the job again with this version of the engine.", kind=kind.lower()
        )
    layer, value = KINDS[kind]
    if mesh.is_editmode and value and layer not in mesh.color_attributes:
        raise UserError("Leave Edit Mode first: these colors are made from values that the mesh has in Object Mode.")
    for material in mesh.materials:
        show_texture(material, kind == "TEXTURE")
    if kind != "TEXTURE":
        _show_colors(mesh, kind)


def _show_colors(mesh: bpy.types.Mesh, kind: str) -> None:
    """Choose the vertex colours of a kind; those of a value are made when first shown."""
    layer, value = KINDS[kind]
    if not value or layer in mesh.color_attributes:
        choose_colors(mesh, layer)
        return
    values = np.empty(len(mesh.vertices), np.int32 if mesh.attributes[value].data_type == "INT" else np.float32)
    mesh.attributes[value].data.foreach_get("value", values)
    top = 1.0 if kind == "CONFIDENCE" else max(1.0, float(np.percentile(values, _TOP)))
    mesh[f"mgf_top_{value}"] = top
    rgba = np.ones((len(values), 4), np.float32)
    rgba[:, :3] = ramp(np.clip(values / top, 0, 1), _STOPS)
    set_colors(mesh, rgba, layer)


def scale_text(mesh: bpy.types.Mesh, kind: str) -> str:
    """Return what the ends of the ramp mean, for the panel; hues, because the viewport's light makes bright spots
    dark."""
    if kind == "CONFIDENCE":
        return tr("Violet: low, yellow: high")
    return tr("Violet: no photo, yellow: {count:.0f} or more", count=mesh.get("mgf_top_views", 1.0))


def ramp(values: np.ndarray, stops: np.ndarray) -> np.ndarray:
    """Colour 0..1 by sRGB [..., 3], between evenly spaced stops [N, 3]."""
    at = np.linspace(0, 1, len(stops))
    return np.stack([np.interp(values, at, stops[:, i]) for i in range(3)], axis=-1)
