# SPDX-License-Identifier: GPL-3.0-or-later
"""Draw the state of an import of results: under way, or why it failed."""

import bpy

from ..common.text import draw_sentence, tr
from . import async_import


def draw_waiting(layout: bpy.types.UILayout, scene: bpy.types.Scene) -> None:
    """Draw the state of an import that is not part of a job shown elsewhere."""
    if async_import.under_way(scene):
        draw_sentence(layout, tr("Importing the results"), "SORTTIME")
    elif async_import.problem(scene):
        draw_sentence(layout, async_import.problem(scene), "ERROR")
