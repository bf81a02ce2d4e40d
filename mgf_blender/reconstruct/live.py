# SPDX-License-Identifier: GPL-3.0-or-later
"""The live preview: the training render as one image that is read again whenever the engine says so."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy

from ..common.editors import fit_editors
from ..common.job import Job

NAME = "MGF Preview"


def on_message(job: Job, message: dict[str, Any]) -> None:
    """Read the picture that a ``preview`` message names; a picture that is gone again is left out."""
    if message["type"] == "preview":
        show(Path(str(message.get("path", ""))))


def show(path: Path) -> bpy.types.Image | None:
    """Load or reload the preview image; image editors that show it follow."""
    if not path.is_file():
        return None
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
