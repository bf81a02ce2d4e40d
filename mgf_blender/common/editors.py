# SPDX-License-Identifier: GPL-3.0-or-later
"""Open and arrange editors: show a photo beside the viewport or in its place."""

from __future__ import annotations

import bpy

_TAB = "MGF"
_MARGIN = 0.97  # share of the free space that a photo fills
_unsettled: list[str] = []
_tries = 0


def image_editor(context: bpy.types.Context) -> bpy.types.Area | None:
    """Return an Image Editor of the window; the area under the pointer, or the largest viewport, becomes one if need
    be."""
    if context.screen is None:
        return None
    areas = list(context.screen.areas)
    found = [a for a in areas if a.type == "IMAGE_EDITOR"]
    if found:
        return max(found, key=lambda a: a.width * a.height)
    views = [a for a in areas if a.type == "VIEW_3D"]
    area = context.area if context.area in views else max(views, key=lambda a: a.width * a.height, default=None)
    if area is not None:
        _become(area, "IMAGE_EDITOR")
    return area


def show_image(context: bpy.types.Context, image: bpy.types.Image) -> None:
    """Show an image in an Image Editor, see :func:`image_editor`."""
    area = image_editor(context)
    if area is not None:
        area.spaces.active.image = image
        area.tag_redraw()


def viewport(context: bpy.types.Context) -> bpy.types.Area | None:
    """Return a 3D viewport of the window; the Image Editor under the pointer becomes one if there is none."""
    if context.screen is None:
        return None
    found = next((a for a in context.screen.areas if a.type == "VIEW_3D"), None)
    if found is None and context.area is not None and context.area.type == "IMAGE_EDITOR":
        found = context.area
        _become(found, "VIEW_3D")
    return found


def _become(area: bpy.types.Area, kind: str) -> None:
    """Turn an area into another editor with our tab open; what needs a drawn area first is left to a timer."""
    global _tries
    area.type = kind
    area.spaces.active.show_region_ui = True
    if not bpy.app.background:
        _tries = 20
        _unsettled.append(kind)
        if not bpy.app.timers.is_registered(_settle):
            bpy.app.timers.register(_settle, first_interval=0.05)


def _settle() -> float | None:
    """Open our tab in the new editors and fit the photo into its editor."""
    global _tries
    _tries -= 1
    for kind in list(_unsettled):
        if all(_prepare(window, area) for window, area in areas_of(kind)):
            _unsettled.remove(kind)
    if _unsettled and _tries > 0:
        return 0.05
    _unsettled.clear()
    return None


def areas_of(kind: str) -> list[tuple[bpy.types.Window, bpy.types.Area]]:
    """Return the areas of a kind (``VIEW_3D``, ``IMAGE_EDITOR``) with their windows."""
    windows = [w for manager in bpy.data.window_managers for w in manager.windows]
    return [(w, a) for w in windows for a in w.screen.areas if a.type == kind]


def _prepare(window: bpy.types.Window, area: bpy.types.Area) -> bool:
    """Prepare one area; False while it has not been drawn yet."""
    sidebar = next(r for r in area.regions if r.type == "UI")
    try:
        sidebar.active_panel_category = _TAB
    except (AttributeError, TypeError):
        return False
    area.tag_redraw()
    if area.type == "IMAGE_EDITOR":
        fit_photo(window, area)
    return True


def fit_photo(window: bpy.types.Window, area: bpy.types.Area) -> None:
    """Show the whole photo of an Image Editor beside the sidebar, which lies over the picture."""
    main, sidebar = (next(r for r in area.regions if r.type == kind) for kind in ("WINDOW", "UI"))
    space = area.spaces.active
    if space.image is None or not all(space.image.size):
        return
    covered = sidebar.width if sidebars_overlap() else 0
    width, height = space.image.size
    zoom = _MARGIN * min((main.width - covered) / width, main.height / height)
    with bpy.context.temp_override(window=window, area=area, region=main):
        bpy.ops.image.view_all(fit_view=True)
        if zoom > 0:
            bpy.ops.image.view_zoom_ratio(ratio=zoom)
            bpy.ops.image.view_pan(offset=(covered / 2 / zoom, 0.0))


def fit_editors(image: bpy.types.Image) -> None:
    """Fit an image whose size changed into the editors that show it."""
    for window, area in areas_of("IMAGE_EDITOR"):
        if area.spaces.active.image == image:
            fit_photo(window, area)


def sidebars_overlap() -> bool:
    """Tell whether sidebars lie over the editors' content."""
    return bpy.context.preferences.system.use_region_overlap


def register() -> None:
    """Do nothing: the timer starts when an editor changes."""


def unregister() -> None:
    """Leave no timer behind."""
    _unsettled.clear()
    if bpy.app.timers.is_registered(_settle):
        bpy.app.timers.unregister(_settle)
