# SPDX-License-Identifier: GPL-3.0-or-later
"""What is selected and active: asked of the view layer, for a context without a window, as in a timer, cannot say."""

from __future__ import annotations

import bpy


def selected_objects(context: bpy.types.Context) -> list[bpy.types.Object]:
    """Return the selected objects of the view layer."""
    return list(context.view_layer.objects.selected)


def active_object(context: bpy.types.Context) -> bpy.types.Object | None:
    """Return the active object of the view layer."""
    return context.view_layer.objects.active


def select_none(context: bpy.types.Context) -> None:
    """Deselect all objects; Edit Mode and others are left, for the active object would stay in them."""
    layer = context.view_layer
    active = active_object(context)
    if active is not None and active.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    for obj in selected_objects(context):
        obj.select_set(False, view_layer=layer)


def select_only(context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """Make an object the only selected and the active one, where the view layer shows it; other modes are left."""
    layer = context.view_layer
    select_none(context)
    try:
        obj.hide_set(False, view_layer=layer)
        obj.select_set(True, view_layer=layer)
    except RuntimeError:  # its collection is excluded
        return
    layer.objects.active = obj
