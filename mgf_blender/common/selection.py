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


def select_only(context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """Make an object the only selected and the active one, where the view layer shows it; Edit Mode and others of the
    object that was active are left, for it would stay in them."""
    layer = context.view_layer
    before = layer.objects.active
    if before is not None and before != obj and before.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    for other in selected_objects(context):
        other.select_set(False, view_layer=layer)
    try:
        obj.hide_set(False, view_layer=layer)
        obj.select_set(True, view_layer=layer)
    except RuntimeError:  # its collection is excluded
        return
    layer.objects.active = obj
