# SPDX-License-Identifier: GPL-3.0-or-later
"""A magnifier beside the pointer while control points are marked: the photo's own pixels, a cross where a mark is set.

It is drawn as a cursor (``WindowManager.draw_cursor_add``), so that it follows the pointer without redrawing the editor
by a timer. While a mark is dragged the cross is the mark, which with Shift moves a tenth of what the pointer does.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import bpy

from ..common.image_overlay import draw_cross, draw_lines
from ..prompts.properties import photo_of_image
from ..prompts.tool import TOOL_ID
from .properties import active_point

SIDE = 176.0  # of the square, interface pixels
LEAST_ZOOM, ZOOM_FACTOR = 8.0, 4.0  # screen pixels of a photo pixel, and times the editor's own zoom, whichever is more
_AWAY, _EDGE = 28.0, 6.0  # from the pointer, and from the editor's edge, interface pixels
_GAP = 4.0  # screen pixels around the exact place that the cross leaves free
_DARK, _LIGHT, _FRAME = (0.0, 0.0, 0.0, 0.75), (1.0, 0.9, 0.1, 1.0), (0.9, 0.9, 0.9, 1.0)

_dragged: tuple[float, float] | None = None  # the pixel of the mark that is dragged
_handle: Any = None


def show_pixel(uv: tuple[float, float] | None) -> None:
    """Show this pixel of the photo instead of the one under the pointer; None shows that again."""
    global _dragged
    _dragged = uv


def place_magnifier(
    pointer: tuple[float, float], area: tuple[float, float], scale: float
) -> tuple[float, float, float]:
    """Return where the magnifier stands: its left and lower edge, and its side, pixels of the region.

    It is above and right of the pointer, on the other side where there is no room, and never over the pointer unless
    the editor is smaller than two of it.

    Args:
        pointer: the pixel of the region.
        area: width and height of what is free of the region.
        scale: of the interface.
    """
    side = SIDE * scale
    corner = []
    for at, room in zip(pointer, area, strict=True):
        low = at + _AWAY * scale
        if low + side + _EDGE * scale > room:
            low = at - _AWAY * scale - side
        corner.append(min(max(low, _EDGE * scale), max(_EDGE * scale, room - side - _EDGE * scale)))
    return corner[0], corner[1], side


def magnification(zoom: float, scale: float) -> float:
    """Return screen pixels of a photo pixel within the magnifier.

    Args:
        zoom: screen pixels of a photo pixel in the editor.
        scale: of the interface.
    """
    return max(LEAST_ZOOM * scale, ZOOM_FACTOR * zoom)


def visible_part(uv: tuple[float, float], side: float, zoom: float) -> tuple[float, float, float, float]:
    """Return the part of the photo in the magnifier, whose middle is ``uv``: left, top, right, bottom in photo
    pixels."""
    half = side / zoom / 2
    return uv[0] - half, uv[1] - half, uv[0] + half, uv[1] + half


def marks_on_click(context: bpy.types.Context) -> bool:
    """Tell whether a click here would mark a control point: a listed photo, the point tool, a point chosen."""
    space, scene = context.space_data, context.scene
    if space is None or space.type != "IMAGE_EDITOR" or space.image is None or space.ui_mode != "VIEW":
        return False
    if not scene.mgf.georef.marking or active_point(scene) is None or photo_of_image(scene, space.image) < 0:
        return False
    tool = context.workspace.tools.from_space_image_mode("VIEW")
    return tool is not None and tool.idname == TOOL_ID


def draw(xy: tuple[int, int]) -> None:
    """Draw handler of the cursor.

    Args:
        xy: the pointer in the window.
    """
    context = bpy.context
    if not marks_on_click(context):
        return
    region, space = context.region, context.space_data
    pointer = float(xy[0] - region.x), float(xy[1] - region.y)
    width, height = space.image.size
    x, y = region.view2d.region_to_view(*pointer)
    if _dragged is None and not (0 <= x <= 1 and 0 <= y <= 1):
        return
    uv = _dragged if _dragged is not None else (x * width, (1 - y) * height)
    scale = context.preferences.system.ui_scale
    left, low, side = place_magnifier(pointer, _free_size(context.area, region), scale)
    part = visible_part(uv, side, magnification(space.zoom[0], scale))
    _draw_magnifier(space.image, (region.x + left, region.y + low), side, part)


def _free_size(area: bpy.types.Area, region: bpy.types.Region) -> tuple[float, float]:
    """Return the width and height of the region that no sidebar or header covers, from its lower left corner."""
    sides = [r.x for r in area.regions if r.type == "UI" and r.width > 1 and r.x > region.x]
    tops = [r.y for r in area.regions if r.type in {"HEADER", "TOOL_HEADER"} and r.height > 1 and r.y > region.y]
    right, top = min([region.x + region.width, *sides]), min([region.y + region.height, *tops])
    return float(right - region.x), float(top - region.y)


def _draw_magnifier(
    image: bpy.types.Image, corner: tuple[float, float], side: float, part: tuple[float, float, float, float]
) -> None:
    """Draw the square with the photo's pixels, its frame, and the cross whose middle is the exact place."""
    import gpu
    from gpu_extras.batch import batch_for_shader

    x0, y0 = corner
    x1, y1 = x0 + side, y0 + side
    left, top, right, bottom = part
    height = image.size[1]
    corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    pixels = [(left, height - bottom), (right, height - bottom), (right, height - top), (left, height - top)]
    shader = _shader()
    batch = batch_for_shader(shader, "TRIS", {"pos": corners, "pixel": pixels}, indices=[(0, 1, 2), (0, 2, 3)])
    gpu.state.blend_set("NONE")
    shader.bind()
    shader.uniform_float("matrix", gpu.matrix.get_projection_matrix() @ gpu.matrix.get_model_view_matrix())
    shader.uniform_float("size", tuple(map(float, image.size)))
    shader.uniform_sampler("photo", gpu.texture.from_image(image))
    batch.draw(shader)
    draw_cross(((x0 + x1) / 2, (y0 + y1) / 2), side / 2, _GAP, (2.5, _DARK), (1.0, _LIGHT))
    frame = [c for k in range(4) for c in (corners[k], corners[(k + 1) % 4])]
    draw_lines(frame, 4.0, _DARK)
    draw_lines(frame, 1.5, _FRAME)


@cache
def _shader() -> Any:
    """Return a shader that shows a photo's pixels as squares. Blender's textures are scene linear, the editor's are
    not."""
    import gpu

    between = gpu.types.GPUStageInterfaceInfo("mgf_magnifier")
    between.smooth("VEC2", "at")
    info = gpu.types.GPUShaderCreateInfo()
    info.push_constant("MAT4", "matrix")
    info.push_constant("VEC2", "size")
    info.sampler(0, "FLOAT_2D", "photo")
    info.vertex_in(0, "VEC2", "pos")
    info.vertex_in(1, "VEC2", "pixel")
    info.vertex_out(between)
    info.fragment_out(0, "VEC4", "color")
    info.vertex_source("void main() { at = pixel; gl_Position = matrix * vec4(pos, 0.0, 1.0); }")
    info.fragment_source(
        "void main() {"
        "  if (at.x < 0.0 || at.y < 0.0 || at.x >= size.x || at.y >= size.y) {"
        "    color = vec4(0.1, 0.1, 0.1, 1.0); return; }"
        "  ivec2 whole = textureSize(photo, 0);"  # smaller than the photo where the preferences limit textures
        "  ivec2 texel = ivec2(floor(at / size * vec2(whole)));"
        "  vec3 c = max(texelFetch(photo, texel, 0).rgb, 0.0);"
        "  color = vec4(mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c)), 1.0);"
        "}"
    )
    return gpu.shader.create_from_info(info)


def register() -> None:
    """Add the cursor; Blender without a window has none."""
    global _handle
    if not bpy.app.background:
        add: Callable[..., Any] = bpy.types.WindowManager.draw_cursor_add
        _handle = add(draw, (), "IMAGE_EDITOR", "WINDOW")


def unregister() -> None:
    """Remove the cursor."""
    global _handle
    show_pixel(None)
    if _handle is not None:
        bpy.types.WindowManager.draw_cursor_remove(_handle)
        _handle = None
