# SPDX-License-Identifier: GPL-3.0-or-later
"""Turn a scene's state into a job of the engine, and what happens when the job ends."""

from __future__ import annotations

import itertools
import json
import os
from pathlib import Path

import bpy

from ..common import options, runner
from ..common.addon import preferences
from ..common.errors import UserError
from ..common.job import DONE, Job
from ..engine.environment import engine_command
from ..prompts import files
from ..properties import key_of, scene_key, scene_of
from ..results import async_import
from ..results.load import job_name
from . import estimate, preview_image


def job_folder(scene: bpy.types.Scene) -> Path:
    """Return the scene's job folder; chosen beside the .blend, or inside the source, when none is set. An unsaved file
    says nothing of what it holds, so its folder is one that no other job has; a scene's is never another scene's.

    Raises:
        UserError: there is neither a job folder nor a source to put one in.
    """
    state = scene.mgf
    if not state.job_folder:
        if not state.source:
            raise UserError("There is nothing to reconstruct; import a COLMAP scene or photos first.")
        known = _chosen.get(scene_key(scene))
        state.job_folder = known[1] if known is not None and known[0] == state.source else _choose(scene)
        _chosen[scene_key(scene)] = state.source, state.job_folder
    return Path(bpy.path.abspath(state.job_folder))


#: Scene key -> source and the folder chosen for it: an undo takes the property away, the job goes on.
_chosen: dict[str, tuple[str, str]] = {}


def _choose(scene: bpy.types.Scene) -> str:
    """Return a folder for the scene's jobs, as it stands in the property."""
    place = source = Path(bpy.path.abspath(scene.mgf.source))
    if bpy.data.filepath:
        while place.name in {"0", "1", "sparse", "colmap", "dense"} and place != place.parent:
            place = place.parent  # the folder people call the scene by
        first = f"//{Path(bpy.data.filepath).stem}_jobs/{place.name or 'building'}"
    else:
        first = str(source / "mgf_job")
    others = [bpy.path.abspath(s.mgf.job_folder) for s in bpy.data.scenes if s.mgf.job_folder]
    names = itertools.chain([first], (f"{first}_{number}" for number in itertools.count(2)))
    free = (n for n in names if bpy.path.abspath(n) not in others)
    return next(n for n in free if bpy.data.filepath or not _is_used(Path(bpy.path.abspath(n))))


def _is_used(folder: Path) -> bool:
    """Tell whether a job, or anything else, lies in a folder already."""
    try:
        return os.path.lexists(_prompts_path(folder)) or any(folder.iterdir())
    except OSError:  # not there, no folder, or not ours to read
        return os.path.lexists(folder)


def _prompts_path(folder: Path) -> Path:
    """Return the path of a job's clicks. Beside the folder, not in it: the engine takes only an empty folder for a new
    job."""
    return folder.with_name(folder.name + ".prompts.json")


def has_job_file(scene: bpy.types.Scene, name: str = "") -> bool:
    """Tell whether the scene's job folder exists and holds a file; chooses no folder, so that drawing changes
    nothing."""
    return bool(scene.mgf.job_folder) and os.path.exists(job_folder(scene) / name)  # False where it may not be read


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
        raise UserError("There is nothing to reconstruct; import a COLMAP scene or photos first.")
    command = [kind, bpy.path.abspath(state.source), "--out", str(folder), "--progress", "json", "--cancel-on-eof"]
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


def job_options(scene: bpy.types.Scene, folder: Path) -> list[str]:
    """Return arguments for the options of a job in this folder, as the panel has them."""
    given = options.arguments(scene.mgf.options, given_options(folder))
    prefs = preferences()
    if prefs is not None and prefs.weights_folder and not scene.mgf.options.weights:
        given += ["--set", f"weights={bpy.path.abspath(prefs.weights_folder)}"]
    return given


def given_options(folder: Path) -> dict[str, object]:
    """Return the options an earlier run in this folder was given; empty when there is none."""
    return _job_record(folder, "given")


def broke_off(folder: Path) -> bool:
    """Tell whether the last run in this folder ended within a stage; results of a run before it may be there
    nevertheless.

    A run that was to end earlier, as Suggest and Find Masks are, leaves the stages after its own unbegun.
    """
    done = _job_record(folder, "stages")
    following = next((stage for stage in options.STAGES if stage not in done), None)
    return following is not None and (folder / f".started-{following}").exists()


def _job_record(folder: Path, name: str) -> dict[str, object]:
    """Return what the engine noted under a name in the job file; empty where it cannot be read."""
    try:
        return dict(json.loads((folder / "job.json").read_text(encoding="utf-8"))[name])
    except (OSError, ValueError, KeyError, TypeError):
        return {}


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
    path = _prompts_path(folder)
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


def _push_undo(manager: bpy.types.WindowManager, name: str) -> None:
    """Push an undo step for what changed in a scene that no window shows, where operators make none.

    Without it an undo of anything before leaves collections with freed objects, which ends Blender.
    """
    if manager.windows:
        with bpy.context.temp_override(window=manager.windows[0]):
            bpy.ops.ed.undo_push(message=name.replace("_", " ").title())


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
