# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs of a scene: their arguments, and those of commands that are no reconstruction."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import bpy

from ..common import options
from ..common.addon import preferences
from ..common.job import Job
from ..engine.environment import engine_command
from ..job_folder import given_options, job_folder, job_name
from ..scene_keys import scene_key

#: Arguments of every job: messages that :class:`~mgf_blender.common.job.Job` reads, and an end when Blender is gone.
MESSAGES = ("--progress", "json", "--cancel-on-eof")


def tool_job(scene: bpy.types.Scene, kind: str, command: list[str], on_end: Callable[[Job], None] | None = None) -> Job:
    """Make the job of a command that is no reconstruction, such as ``drawings``; starts nothing.

    Args:
        scene: that asks for it.
        kind: of the job.
        command: of the engine, with its arguments.
        on_end: called when the job ends.

    Raises:
        UserError: there is no engine.
    """
    folder = job_folder(scene)
    return Job(engine_command(*command, *MESSAGES), folder, job_name(folder), kind, scene_key(scene), on_end=on_end)


def job_options(scene: bpy.types.Scene, folder: Path) -> list[str]:
    """Return arguments for the options of a job in this folder, as the panel has them."""
    given = options.arguments(scene.mgf.options, given_options(folder))
    prefs = preferences()
    if prefs is not None and prefs.weights_folder and not scene.mgf.options.weights:
        given += ["--set", f"weights={bpy.path.abspath(prefs.weights_folder)}"]
    return given
