# SPDX-License-Identifier: GPL-3.0-or-later
"""Call operators of ours from outside any editor, as timers and jobs that end do: each call is one undo step."""

from __future__ import annotations

import bpy

from .common import runner
from .scene_keys import key_of


def run_in(scene: bpy.types.Scene, name: str, **properties: object) -> str:
    """Call an operator of ours in a scene, as one undo step, from outside any area.

    Returns:
        Why it failed, which also joins the warnings of the scene's last job; empty when it did not.
    """
    manager = bpy.context.window_manager
    window = next((w for w in manager.windows if w.scene == scene), None)
    override = {"scene": scene, "view_layer": scene.view_layers[0]}
    if window is not None:
        override["window"] = window
    try:
        with bpy.context.temp_override(**override):
            getattr(bpy.ops.mgf, name)("EXEC_DEFAULT", window is not None, **properties)
        if window is None:
            _push_undo(manager, name)
    except RuntimeError as error:
        text = str(error).removeprefix("Error: ").strip()
        latest = runner.jobs(key_of(scene))
        if latest:
            latest[-1].warnings.append(text)
        return text
    return ""


def _push_undo(manager: bpy.types.WindowManager, name: str) -> None:
    """Push an undo step for what changed in a scene that no window shows, where operators make none.

    Without it an undo of anything before leaves collections with freed objects, which ends Blender.
    """
    if manager.windows:
        with bpy.context.temp_override(window=manager.windows[0]):
            bpy.ops.ed.undo_push(message=name.replace("_", " ").title())
