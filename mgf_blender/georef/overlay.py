# SPDX-License-Identifier: GPL-3.0-or-later
"""Marks of control points and their predicted places, drawn over the photo in the Image Editor."""

from __future__ import annotations

import math

import bpy

from ..common.image_overlay import ImageOverlay, draw_cross, draw_lines
from ..job_folder import has_job_file, job_folder
from ..prompts.properties import photo_of_image
from .files import read_known_points
from .properties import active_point

_CHOSEN, _OTHER, _WRONG = (1.0, 0.9, 0.1, 1.0), (0.75, 0.75, 0.75, 0.9), (1.0, 0.25, 0.2, 1.0)
_DARK = (0.0, 0.0, 0.0, 0.7)
_ARM, _GAP = 12.0, 3.0  # of a mark's cross, interface pixels; the middle stays free
_LEAST_RING = 9.0


def draw() -> None:
    """Draw handler of the Image Editor."""
    context = bpy.context
    scene, space = context.scene, context.space_data
    state, index = scene.mgf.georef, photo_of_image(scene, space.image)
    if index < 0 or not state.marking:
        return
    photo, chosen = scene.mgf.photos[index], active_point(scene)
    name = chosen.name if chosen is not None else ""
    view, scale = context.region.view2d, context.preferences.system.ui_scale
    width, height = (max(1, v) for v in space.image.size)
    known = read_known_points(job_folder(scene)) if has_job_file(scene) else {}

    def at(u: float, v: float) -> tuple[float, float]:
        return view.view_to_region(u / width, 1 - v / height, clip=False)

    for point in known.values():
        if photo.name in point.photos:
            u, v, radius = point.photos[photo.name]
            ring = max(_LEAST_RING * scale, radius * max(1e-6, space.zoom[0]))
            _ring(*at(u, v), ring, _CHOSEN if point.name == name else _OTHER)
            _name(*at(u, v), ring, point.name, _CHOSEN if point.name == name else _OTHER)
    for mark in state.marks:
        if mark.photo == photo.name:
            own = known.get(mark.point)
            wrong = own is not None and photo.name in own.wrong
            color = _WRONG if wrong else _CHOSEN if mark.point == name else _OTHER
            draw_cross(at(*mark.uv), _ARM * scale, _GAP * scale, (3.0 * scale, _DARK), (1.5 * scale, color))
            if own is None or photo.name not in own.photos:
                _name(*at(*mark.uv), _ARM * scale, mark.point, color)


def _ring(x: float, y: float, radius: float, color: tuple[float, ...]) -> None:
    turn = [2 * math.pi * k / 48 for k in range(48)]
    points = [(x + radius * math.cos(t), y + radius * math.sin(t)) for t in turn]
    ends = [p for k in range(0, 48, 2) for p in (points[k], points[k + 1])]  # dashed
    draw_lines(ends, 1.5, color)


def _name(x: float, y: float, away: float, text: str, color: tuple[float, ...]) -> None:
    import blf

    scale = bpy.context.preferences.system.ui_scale
    blf.size(0, 12 * scale)
    blf.enable(0, blf.SHADOW)
    blf.shadow(0, 3, 0.0, 0.0, 0.0, 0.9)
    blf.color(0, *color)
    blf.position(0, x + 0.75 * away + 2 * scale, y + 0.75 * away + 2 * scale, 0)
    blf.draw(0, text)
    blf.disable(0, blf.SHADOW)


_overlay = ImageOverlay(draw)
register, unregister = _overlay.add, _overlay.remove
