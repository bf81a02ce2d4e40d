# SPDX-License-Identifier: GPL-3.0-or-later
"""Turn the 3D viewports to what was imported, and set which colours they draw."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Vector

from .editors import areas_of, sidebars_overlap

_ONE_SIDE = 0.3  # of unit vectors towards the cameras, the length of the mean: 0 for a ring, 1 for a single direction
_LOOK_DOWN = np.radians(20.0)


def side_of_cameras(middle: np.ndarray, centres: np.ndarray) -> np.ndarray | None:
    """Return the direction from which photos show what lies at ``middle``, unit [3], world; looking down a little.

    None where the cameras stand all around it, or above: no side is theirs.

    Args:
        centres: of the cameras, [N, 3], world.
    """
    away = (centres - middle)[:, :2]
    away = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
    mean = away.mean(axis=0) if len(away) else np.zeros(2)
    length = float(np.linalg.norm(mean))
    if length < _ONE_SIDE:
        return None
    return np.array([*(np.cos(_LOOK_DOWN) * mean / length), np.sin(_LOOK_DOWN)])


def frame_scene(
    context: bpy.types.Context,
    middle: np.ndarray,
    reach: float,
    texture: bool = False,
    side: np.ndarray | None = None,
    lit: bool = True,
) -> None:
    """Turn the window's viewports to an imported scene and let them draw its colours.

    Args:
        context: tells the window.
        middle: [3], world.
        reach: radius of what should be seen, world units.
        texture: whether the colours are a texture's, not the vertices'.
        side: from where it should be seen, unit [3]; None keeps the direction.
        lit: whether the studio light shall show its shape; points of a few pixels are dark specks in it.
    """
    for area in _viewports(context):
        space = area.spaces.active
        space.region_3d.view_location = middle.tolist()
        space.region_3d.view_distance = 2.6 * reach  # the sidebar lies over a quarter of the view
        if side is not None:  # a front takes more of the width
            space.region_3d.view_distance = 3.0 * reach
            space.region_3d.view_rotation = Vector(side.tolist()).to_track_quat("Z", "Y")
        space.clip_start = min(space.clip_start, 1e-3 * reach)
        space.clip_end = max(space.clip_end, 100.0 * reach)
        space.shading.color_type = "TEXTURE" if texture else "VERTEX"
        _light(space.shading, lit)
        space.overlay.show_relationship_lines = False  # one dashed line per camera hides the scene
        area.tag_redraw()


def _light(shading: bpy.types.View3DShading, lit: bool) -> None:
    """Choose between the studio light and none."""
    if shading.light == ("FLAT" if lit else "STUDIO"):  # a MatCap is the user's own choice
        shading.light = "STUDIO" if lit else "FLAT"


def scale_views(context: bpy.types.Context, factor: float) -> None:
    """Let the window's viewports show the same after everything was scaled about the world's origin."""
    for area in _viewports(context):
        space = area.spaces.active
        space.region_3d.view_location = factor * space.region_3d.view_location
        space.region_3d.view_distance *= factor
        space.clip_end = max(space.clip_end, factor * space.clip_end)
        space.clip_start = min(space.clip_start, factor * space.clip_start)


def enter_camera(context: bpy.types.Context) -> None:
    """Let the window's viewports look through the active camera, its picture beside the sidebar."""
    for area in _viewports(context):
        view = area.spaces.active.region_3d
        if view.view_perspective != "CAMERA":  # else the user may have moved the picture
            view.view_camera_offset = (_covered_share(area), 0.0)
        view.view_perspective = "CAMERA"


def _viewports(context: bpy.types.Context) -> list[bpy.types.Area]:
    """Return the 3D viewports of the window; none where Blender runs without one, or where it shows another scene."""
    if context.screen is None or (context.window is not None and context.window.scene != context.scene):
        return []
    areas = context.screen.areas
    return [area for area in areas if area.type == "VIEW_3D" and area.spaces.active.region_3d is not None]


def _covered_share(area: bpy.types.Area) -> float:
    """Return half of what sidebar and toolbar cover to the right, as a share of the area's width."""
    width = {r.type: r.width for r in area.regions}
    if not sidebars_overlap() or width["WINDOW"] <= 1:
        return 0.0
    return (width.get("UI", 0) - width.get("TOOLS", 0)) / 2 / width["WINDOW"]


def draw_texture(scene: bpy.types.Scene, on: bool) -> None:
    """Let the viewports that show a scene draw textures in solid mode; or vertex colours again, where they did."""
    for window, area in areas_of("VIEW_3D"):
        shading = area.spaces.active.shading
        if window.scene == scene and (on or shading.color_type == "TEXTURE"):
            shading.color_type = "TEXTURE" if on else "VERTEX"
            area.tag_redraw()


def follow_paint(scene: bpy.types.Scene, texture: bool, lit: bool | None = None) -> None:
    """Bring the viewports that draw our colours in step with what a scene's mesh is painted with by now.

    Args:
        scene: whose viewports are meant.
        texture: whether the colours are a texture's.
        lit: see :func:`frame_scene`; None leaves the light as it is.
    """
    for window, area in areas_of("VIEW_3D"):
        shading = area.spaces.active.shading
        if window.scene == scene and shading.color_type in {"TEXTURE", "VERTEX"}:
            shading.color_type = "TEXTURE" if texture else "VERTEX"
            if lit is not None:
                _light(shading, lit)
            area.tag_redraw()
