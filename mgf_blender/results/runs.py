# SPDX-License-Identifier: GPL-3.0-or-later
"""Results of a job's earlier runs, kept in ``runs/1``, ``runs/2`` … of its folder: found, and removed on request."""

from __future__ import annotations

import shutil
from pathlib import Path

import bpy

from ..common.errors import UserError, reason

_FOLDER, _RECORD = "runs", "run.json"  # the engine writes the record last


def old_runs(job: Path) -> list[Path]:
    """Return folders of the finished runs but the last, which is the job's present result; oldest first."""
    try:
        names = [path.name for path in (job / _FOLDER).iterdir() if path.name.isdecimal()]
    except OSError:
        return []
    folders = [job / _FOLDER / name for name in sorted(names, key=int)]
    return [folder for folder in folders if (folder / _RECORD).is_file()][:-1]


def shown_runs(runs: list[Path]) -> list[Path]:
    """Return those of the runs whose texture or renders this .blend uses."""
    users = bpy.data.user_map(subset=[image for image in bpy.data.images if image.filepath])
    pictures = {Path(bpy.path.abspath(image.filepath)) for image, by in users.items() if by}
    used = {folder for picture in pictures for folder in picture.parents}
    return [run for run in runs if run in used]


def remove_runs(runs: list[Path]) -> None:
    """Delete the folders of runs.

    Raises:
        UserError: one cannot be deleted; those before it are gone.
    """
    for run in runs:
        try:
            (run / _RECORD).unlink()  # first: what is left of it is no run any more
            shutil.rmtree(run)
        except OSError as error:
            raise UserError(
                "Cannot delete '{path}' ({reason}); close what uses it and try again.", path=run, reason=reason(error)
            ) from error
