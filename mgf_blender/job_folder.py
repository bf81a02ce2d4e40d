# SPDX-License-Identifier: GPL-3.0-or-later
"""The job folder of a scene: which it is, and what earlier runs of the engine left in it."""

from __future__ import annotations

import itertools
import os
import re
from pathlib import Path

import bpy

from .common import options
from .common.errors import UserError
from .common.json_cache import JsonCache
from .scene_keys import scene_key

_job_files = JsonCache[dict[str, object]](lambda path, data: dict(data))  # panels that are drawn ask
_UNNAMED = re.compile(r"mgf_job(_\d+)?")  # default folders, which lie in one that people gave a name
#: Scene key -> source and the folder chosen for it: an undo takes the property away, the job goes on.
_chosen: dict[str, tuple[str, str]] = {}


def job_folder(scene: bpy.types.Scene) -> Path:
    """Return the scene's job folder; chosen beside the .blend, or inside the source, when none is set. An unsaved file
    says nothing of what it holds, so its folder is one that no other job has; a scene's is never another scene's.

    Raises:
        UserError: there is neither a job folder nor a source to put one in.
    """
    state = scene.mgf
    if not state.job_folder:
        if not state.source:
            raise UserError("There is nothing to reconstruct; import photos or a COLMAP scene first.")
        known = _chosen.get(scene_key(scene))
        state.job_folder = known[1] if known is not None and known[0] == state.source else _choose(scene)
        _chosen[scene_key(scene)] = state.source, state.job_folder
    return Path(bpy.path.abspath(state.job_folder))


def has_job_file(scene: bpy.types.Scene, name: str = "") -> bool:
    """Tell whether the scene's job folder exists and holds a file; chooses no folder, so that drawing changes
    nothing."""
    return bool(scene.mgf.job_folder) and os.path.exists(job_folder(scene) / name)  # False where it may not be read


def prompts_path(folder: Path) -> Path:
    """Return the path of a job's clicks. Beside the folder, not in it: the engine takes only an empty folder for a new
    job."""
    return folder.with_name(folder.name + ".prompts.json")


def job_name(folder: Path) -> str:
    """Return what people call a job: the name of its folder, or of the folder around one that was never named."""
    return folder.parent.name if _UNNAMED.fullmatch(folder.name) and folder.parent.name else folder.name or "Building"


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
    record = (_job_files.get(folder / "job.json") or {}).get(name)
    return dict(record) if isinstance(record, dict) else {}


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
        return os.path.lexists(prompts_path(folder)) or any(folder.iterdir())
    except OSError:  # not there, no folder, or not ours to read
        return os.path.lexists(folder)
