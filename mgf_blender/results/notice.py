# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panels say while results are on their way into the scene, and when they did not arrive."""

import bpy

from ..common.text import draw_sentence, tr
from . import arrival


def draw_waiting(layout: bpy.types.UILayout, scene: bpy.types.Scene) -> None:
    """The state of an import that is not part of a job shown elsewhere."""
    if arrival.under_way(scene):
        draw_sentence(layout, tr("Bringing the results in"), "SORTTIME")
    elif arrival.problem(scene):
        draw_sentence(layout, arrival.problem(scene), "ERROR")
