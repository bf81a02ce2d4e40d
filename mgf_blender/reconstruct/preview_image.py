# SPDX-License-Identifier: GPL-3.0-or-later
"""Live preview of the training: one image, reloaded whenever the engine has written it anew."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy

from ..common.editors import areas_of, fit_editors
from ..common.job import Job

NAME = "MGF Preview"
_newest = ""  # file of the newest picture
_editors: list[int] = []  # the Image Editors that showed it when an undo began


def on_message(job: Job, message: dict[str, Any]) -> None:
    """Read the picture that a ``preview`` message names; a picture that is gone again is left out."""
    if message["type"] == "preview":
        show(Path(str(message.get("path", ""))))


def show(path: Path) -> bpy.types.Image | None:
    """Load or reload the preview image; image editors that show it follow."""
    global _newest
    if not path.is_file():
        return None
    _newest = str(path)
    image = bpy.data.images.get(NAME)
    if image is None:
        image = bpy.data.images.load(str(path))
        image.name = NAME
    else:
        size = tuple(image.size)
        image.filepath = str(path)
        image.reload()
        if tuple(image.size) != size:
            fit_editors(image)
    return image


@bpy.app.handlers.persistent
def before_undo(*_: object) -> None:
    """Note which editors show the preview (handler), for an undo takes away what no undo step holds."""
    image = bpy.data.images.get(NAME)
    showing = [a for _, a in areas_of("IMAGE_EDITOR") if image is not None and a.spaces.active.image == image]
    _editors[:] = [area.as_pointer() for area in showing]


@bpy.app.handlers.persistent
def after_undo(*_: object) -> None:
    """Show it there again (handler)."""
    image = bpy.data.images.get(NAME) or (show(Path(_newest)) if _editors else None)
    for _, area in areas_of("IMAGE_EDITOR"):
        if image is not None and area.as_pointer() in _editors and area.spaces.active.image is None:
            area.spaces.active.image = image
    _editors.clear()


_HANDLERS = (
    (bpy.app.handlers.undo_pre, before_undo),
    (bpy.app.handlers.redo_pre, before_undo),
    (bpy.app.handlers.undo_post, after_undo),
    (bpy.app.handlers.redo_post, after_undo),
)


def register() -> None:
    """Follow undo and redo."""
    for handlers, function in _HANDLERS:
        handlers.append(function)


def unregister() -> None:
    """Follow them no more."""
    for handlers, function in _HANDLERS:
        handlers.remove(function)
