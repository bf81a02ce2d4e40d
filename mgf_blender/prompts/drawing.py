# SPDX-License-Identifier: GPL-3.0-or-later
"""Clicks and masks drawn over the photo in the Image Editor."""

from __future__ import annotations

import math

import bpy

from ..common.image_overlay import ImageOverlay, draw_triangles
from . import overlay, preview
from .properties import BUILDING, photo_of_image

_POSITIVE, _NEGATIVE = (0.16, 0.85, 0.36, 1.0), (0.95, 0.23, 0.2, 1.0)
_PARTS = ((0.25, 0.6, 1.0, 1.0), (1.0, 0.75, 0.15, 1.0), (0.8, 0.4, 1.0, 1.0), (0.2, 0.9, 0.9, 1.0))
_RING = (0.0, 0.0, 0.0, 0.9)
RADIUS = 6.0  # of a click, in interface pixels


def part_color(part: str) -> tuple[float, float, float, float]:
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
        preview.notice(scene, photo)
    if scene.mgf.show_mask and not scene.mgf.georef.marking:  # which needs the photo's own edges
        overlay.draw(scene, photo, view)
    scale = context.preferences.system.ui_scale
    width, height = space.image.size
    for click in photo.clicks:
        x, y = view.view_to_region(click.uv[0] / max(width, 1), 1 - click.uv[1] / max(height, 1), clip=False)
        color = _NEGATIVE if click.negative else _POSITIVE if click.part == BUILDING else part_color(click.part)
        _disc(x, y, (RADIUS + 2) * scale, _RING)
        _disc(x, y, RADIUS * scale, color)
        if click.proposed:  # a ring
            _disc(x, y, (RADIUS - 2) * scale, _RING)
        _bar(x, y, RADIUS * scale, horizontal=True)
        if not click.negative:
            _bar(x, y, RADIUS * scale, horizontal=False)


def _disc(x: float, y: float, radius: float, color: tuple[float, float, float, float]) -> None:
    corners = 20
    ring = [
        (x + radius * math.cos(2 * math.pi * i / corners), y + radius * math.sin(2 * math.pi * i / corners))
        for i in range(corners)
    ]
    draw_triangles([(x, y), *ring], [(0, i + 1, (i + 1) % corners + 1) for i in range(corners)], color)


def _bar(x: float, y: float, radius: float, horizontal: bool) -> None:
    """Draw half of a plus, or a minus: signs that do not rely on colour."""
    a, b = (0.6 * radius, 0.16 * radius) if horizontal else (0.16 * radius, 0.6 * radius)
    draw_triangles(
        [(x - a, y - b), (x + a, y - b), (x + a, y + b), (x - a, y + b)], [(0, 1, 2), (0, 2, 3)], (1, 1, 1, 1)
    )


_overlay = ImageOverlay(draw)


def register() -> None:
    """Add the handler."""
    _overlay.add()


def unregister() -> None:
    """Remove the handler and the textures."""
    _overlay.remove()
    overlay.forget()
