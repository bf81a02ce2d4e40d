# SPDX-License-Identifier: GPL-3.0-or-later
"""Clicks and masks drawn over the photo in the Image Editor."""

from __future__ import annotations

import math

import bpy

from ..common.image_overlay import ImageOverlay, draw_triangles
from . import overlay, preview
from .properties import BUILDING, marks_control_points, photo_of_image

Color = tuple[float, float, float, float]
_POSITIVE, _NEGATIVE = (0.16, 0.85, 0.36, 1.0), (0.95, 0.23, 0.2, 1.0)
_PARTS = ((0.25, 0.6, 1.0, 1.0), (1.0, 0.75, 0.15, 1.0), (0.8, 0.4, 1.0, 1.0), (0.2, 0.9, 0.9, 1.0))
_RIM = (0.0, 0.0, 0.0, 0.9)
_CORNERS = 20  # of a circle
RADIUS = 6.0  # of a click, in interface pixels


def part_color(part: str) -> Color:
    """Return the colour of a part's clicks, the same in every photo."""
    return _PARTS[sum(part.encode()) % len(_PARTS)]


def draw() -> None:
    """Draw handler of the Image Editor."""
    context = bpy.context
    scene, space = context.scene, context.space_data
    index = photo_of_image(scene, space.image)
    if index < 0:
        return
    photo = scene.mgf.photos[index]
    view = context.region.view2d
    if not overlay.job_knows(scene, photo):
        preview.note_clicks(scene, photo)
    if scene.mgf.show_mask and not marks_control_points(scene):  # which needs the photo's own edges
        overlay.draw(scene, photo, view)
    scale = context.preferences.system.ui_scale
    width, height = space.image.size
    for click in photo.clicks:
        x, y = view.view_to_region(click.uv[0] / max(width, 1), 1 - click.uv[1] / max(height, 1), clip=False)
        color = _NEGATIVE if click.negative else _POSITIVE if click.part == BUILDING else part_color(click.part)
        _draw_click(x, y, scale, color, click)


def _draw_click(x: float, y: float, scale: float, color: Color, click: bpy.types.PropertyGroup) -> None:
    """Draw a click as a disc, or a proposed one as a wide ring through which the photo shows; and its sign."""
    if click.proposed:
        _ring(x, y, (RADIUS + 1) * scale, (RADIUS + 5) * scale, _RIM)
        _ring(x, y, (RADIUS + 2) * scale, (RADIUS + 4) * scale, color)
    else:
        _ring(x, y, 0.0, (RADIUS + 2) * scale, _RIM)
        _ring(x, y, 0.0, RADIUS * scale, color)
    sign = color if click.proposed else (1.0, 1.0, 1.0, 1.0)
    _bar(x, y, RADIUS * scale, sign, horizontal=True)
    if not click.negative:
        _bar(x, y, RADIUS * scale, sign, horizontal=False)


def ring_triangles(
    x: float, y: float, inner: float, outer: float
) -> tuple[list[tuple[float, float]], list[tuple[int, int, int]]]:
    """Return corners and triangles of a ring, or of a disc where the inner radius is 0.

    Args:
        x: of its centre, pixels of the region.
        y: of its centre.
        inner: radius, pixels.
        outer: radius.
    """
    turns = [2 * math.pi * i / _CORNERS for i in range(_CORNERS)]
    points = [(x + r * math.cos(t), y + r * math.sin(t)) for r in (inner, outer) for t in turns]
    sides = [(i, (i + 1) % _CORNERS) for i in range(_CORNERS)]
    triangles = [t for i, j in sides for t in ((i, i + _CORNERS, j + _CORNERS), (i, j + _CORNERS, j))]
    return points, triangles


def _ring(x: float, y: float, inner: float, outer: float, color: Color) -> None:
    draw_triangles(*ring_triangles(x, y, inner, outer), color)


def _bar(x: float, y: float, radius: float, color: Color, horizontal: bool) -> None:
    """Draw half of a plus, or a minus: signs that do not rely on colour."""
    a, b = (0.6 * radius, 0.16 * radius) if horizontal else (0.16 * radius, 0.6 * radius)
    draw_triangles([(x - a, y - b), (x + a, y - b), (x + a, y + b), (x - a, y + b)], [(0, 1, 2), (0, 2, 3)], color)


_overlay = ImageOverlay(draw)


def register() -> None:
    """Add the handler."""
    _overlay.add()


def unregister() -> None:
    """Remove the handler and the textures."""
    _overlay.remove()
    overlay.forget()
