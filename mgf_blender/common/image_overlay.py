# SPDX-License-Identifier: GPL-3.0-or-later
"""Drawing over the photo in the Image Editor: triangles, lines, and the handler that calls for them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy


def draw_triangles(
    points: list[tuple[float, float]], triangles: list[tuple[int, int, int]], color: tuple[float, ...]
) -> None:
    """Fill triangles of points in the region's pixels."""
    _draw("UNIFORM_COLOR", "TRIS", {"color": color}, points, indices=triangles)


def draw_lines(ends: list[tuple[float, float]], width: float, color: tuple[float, ...]) -> None:
    """Draw a line between every two points, in the region's pixels."""
    import gpu

    values = {"viewportSize": gpu.state.viewport_get()[2:], "lineWidth": width, "color": color}
    _draw("POLYLINE_UNIFORM_COLOR", "LINES", values, [(*p, 0.0) for p in ends])


def draw_cross(middle: tuple[float, float], arm: float, gap: float, *strokes: tuple[float, tuple[float, ...]]) -> None:
    """Draw a cross whose exact middle stays free, in the region's pixels.

    Args:
        middle: of the cross.
        arm: from the middle to the ends.
        gap: from the middle to where the arms begin.
        strokes: widths and colours, drawn one over the other.
    """
    x, y = middle
    ends = [(x - arm, y), (x - gap, y), (x + gap, y), (x + arm, y)]
    ends += [(x, y - arm), (x, y - gap), (x, y + gap), (x, y + arm)]
    for width, color in strokes:
        draw_lines(ends, width, color)


def _draw(shader_name: str, kind: str, values: dict[str, Any], points: list[Any], **given: Any) -> None:
    import gpu
    from gpu_extras.batch import batch_for_shader

    shader = gpu.shader.from_builtin(shader_name)
    gpu.state.blend_set("ALPHA")
    shader.bind()
    for name, value in values.items():
        shader.uniform_float(name, value)
    batch_for_shader(shader, kind, {"pos": points}, **given).draw(shader)
    gpu.state.blend_set("NONE")


class ImageOverlay:
    """A draw handler of the Image Editor; Blender without a window draws nothing."""

    def __init__(self, draw: Callable[[], None]) -> None:
        self.draw = draw
        self._handle: object | None = None

    def add(self) -> None:
        """Draw from now on."""
        if not bpy.app.background:
            self._handle = bpy.types.SpaceImageEditor.draw_handler_add(self.draw, (), "WINDOW", "POST_PIXEL")

    def remove(self) -> None:
        """Draw no more."""
        if self._handle is not None:
            bpy.types.SpaceImageEditor.draw_handler_remove(self._handle, "WINDOW")
            self._handle = None
