# SPDX-License-Identifier: GPL-3.0-or-later
"""Base of the panels for a finished job: when they show, the button that starts a run, and its progress."""

from typing import ClassVar

import bpy

from ..common import runner
from ..common.panels import SidebarPanel
from ..job_folder import has_job_file
from ..scene_keys import key_of
from .status_label import draw_job


class FinishedJobPanel(SidebarPanel):
    """Closed at first, and shown once the job has a mesh."""

    bl_options: ClassVar = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_job_file(context.scene, "deliver.json")


def draw_run(
    layout: bpy.types.UILayout,
    scene: bpy.types.Scene,
    kinds: tuple[str, ...],
    operator: str,
    icon: str,
    second: tuple[str, str] | None = None,
) -> bool:
    """Draw the button that starts a run, where none of these kinds goes on, and how the last one does or did.

    Args:
        layout: to draw into.
        scene: whose runs are meant.
        kinds: of runs, the one that the button starts first.
        operator: idname of the one that starts it.
        icon: of the button.
        second: operator and icon of a button below it.

    Returns:
        Whether none goes on.
    """
    idle = not runner.live_job(key_of(scene), kinds)
    if idle:
        row = layout.row()
        row.scale_y = 1.4
        row.operator(operator, icon=icon)
        if second is not None:
            layout.operator(second[0], icon=second[1])
    job = runner.last_job(key_of(scene), kinds)
    if job is not None:
        draw_job(layout, job)
    return idle
