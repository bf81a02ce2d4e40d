# SPDX-License-Identifier: GPL-3.0-or-later
"""Draw a hint in the panels when there is no engine."""

import bpy

from ..common.errors import UserError
from ..common.text import draw_sentence, tr
from . import current_task
from .environment import engine_python


def draw_engine_missing(layout: bpy.types.UILayout) -> bool:
    """Say what is wrong with the engine or how far its installation is, and lead to the preferences; True when there is
    none."""
    try:
        engine_python()
    except UserError as error:
        _, task = current_task.current()
        if task is not None and current_task.installing():
            draw_sentence(layout, str(error), "INFO")
            layout.progress(factor=task.fraction, text=tr(task.title), translate=False)
        else:
            draw_sentence(layout, str(error), "ERROR")
        layout.operator("mgf.show_preferences", icon="PREFERENCES")
        return True
    return False
