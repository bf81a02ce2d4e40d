# SPDX-License-Identifier: GPL-3.0-or-later
"""Turn a scene's state into a job of the engine, and what happens when the job ends."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..common.errors import UserError
from ..common.job import DONE, Job
from ..engine.environment import engine_command
from ..job_folder import job_folder, job_name, prompts_path
from ..jobs.start import MESSAGES, job_options
from ..operator_calls import run_in
from ..prompts import files
from ..results import async_import
from ..scene_keys import scene_key, scene_of
from . import estimate, preview_image


def make_job(scene: bpy.types.Scene, kind: str = "reconstruct") -> Job:
    """Make a job for the scene as it stands: writes the clicks beside the job folder, starts nothing.

    Args:
        kind: the engine's command: reconstruct, masks or scene.

    Raises:
        UserError: something needed is missing.
    """
    state = scene.mgf
    folder = job_folder(scene)
    if not state.source:
        raise UserError("There is nothing to reconstruct; import photos or a COLMAP scene first.")
    command = [kind, bpy.path.abspath(state.source), "--out", str(folder), *MESSAGES]
    if kind != "scene":
        command += _guidance(scene, folder)
    command += job_options(scene, folder)
    if (folder / "job.json").is_file():
        command.append("--resume")
    return Job(
        engine_command(*command),
        folder,
        job_name(folder),
        kind,
        scene_key(scene),
        on_message=preview_image.on_message,
        on_end=ended,
    )


def _guidance(scene: bpy.types.Scene, folder: Path) -> list[str]:
    """Return arguments that say where the building is: clicks, the user's masks, or neither when masks are off."""
    state = scene.mgf
    if state.masks_folder:
        return ["--masks", bpy.path.abspath(state.masks_folder)]
    if not any(p.done() for p in state.photos):
        if not state.options.use_masks:
            return []
        raise UserError(
            "No point marks the building; click at least one in the Image Editor, "
            "or choose your own masks under Advanced Options."
        )
    path = prompts_path(folder)
    files.write(scene, path)
    return ["--prompts", str(path)]


def ended(job: Job) -> None:
    """Bring the results in from the job's folder, whatever the scene's field names by now, in the scene that asked.

    A scene that is gone finds them in the folder later.
    """
    scene = scene_of(job.scene_key)
    if job.status != DONE or scene is None:
        return
    if job.kind == "reconstruct" and scene.mgf.import_when_done:
        if in_background():
            run_in(scene, "import_result", directory=str(job.folder))
        else:
            async_import.begin(scene, job.folder)
    elif job.kind == "scene":
        run_in(scene, "import_sfm", directory=str(job.folder))
    elif job.kind == "masks":
        scene.mgf.show_mask = True
    if job.speed is not None:
        estimate.remember(job.speed)


def in_background() -> bool:
    """Tell whether Blender runs without a window, where no timer ticks."""
    return bool(bpy.app.background)
