# SPDX-License-Identifier: GPL-3.0-or-later
"""Small pictures of drawings for the panel. Blender makes them beside its work, and again when a file has changed."""

from __future__ import annotations

from pathlib import Path

import bpy
import bpy.utils.previews

_kept: list[bpy.utils.previews.ImagePreviewCollection] = []  # one while the add-on is registered
_names: dict[str, str] = {}  # path -> its name in the collection, which has the file's time


def preview_icon(path: Path) -> int:
    """Return the icon that shows a picture file; 0 where it cannot be read, or where Blender has no window."""
    if not _kept:
        return 0
    try:
        name = f"{path} {path.stat().st_mtime_ns}"
    except OSError:
        return 0
    if _names.get(str(path)) != name:
        if str(path) in _names:
            del _kept[0][_names[str(path)]]
        _kept[0].load(name, str(path), "IMAGE")
        _names[str(path)] = name
    return int(_kept[0][name].icon_id)


def register() -> None:
    """Make the collection."""
    _kept.append(bpy.utils.previews.new())


def unregister() -> None:
    """Remove the collection and its pictures."""
    bpy.utils.previews.remove(_kept.pop())
    _names.clear()
