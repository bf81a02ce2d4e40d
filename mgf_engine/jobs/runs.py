# SPDX-License-Identifier: GPL-3.0-or-later
"""Keep the results of each run of a job in a numbered folder, so that no later run overwrites them.

A run that comes to its end leaves its results in ``runs/1``, ``runs/2`` … of the job folder, and the ``deliver.json``
of the job names the files there. They are never written again: a .blend that shows the mesh of an earlier run finds
that run's texture and renders, and an undo in Blender brings back a mesh with its own texture. (Packing the texture
into the .blend would do the same for what was imported, at tens of megabytes in every saved file.) The files with
plain names in the job folder are the same ones, as hard links: two names of one file take the room of one. Where a file
system has no hard links they are copies.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mgf_engine import __version__
from mgf_engine.errors import BadInput
from mgf_engine.files.atomic import write_json
from mgf_engine.stages import MANIFEST, outputs

FOLDER = "runs"
RECORD = "run.json"  # written last: a folder without it holds half of a run
_FILES = [output.manifest for output in outputs() if output.manifest]  # entries of the manifest that name files


@dataclass(frozen=True)
class Run:
    """One earlier or present result.

    Attributes:
        number: its folder is ``runs/NUMBER``.
        time: when it was finished, seconds since 1970.
        figures: the headline figures (faces, PSNR ...).
        user_options: the options the user gave.
        size: bytes that removing it frees: of files that have no other name.
    """

    number: int
    time: float
    figures: dict[str, Any]
    user_options: dict[str, Any]
    size: int


def keep_run(job: Path, names: Iterable[str], manifest: dict[str, Any], user_options: dict[str, Any]) -> int:
    """Keep a finished run under a number of its own and write the job's ``deliver.json``, which names its files.

    Args:
        job: the job folder.
        names: files and folders of the job folder that belong to the result; those that are not there are left out.
        manifest: what ``deliver.json`` says, file names relative to the job folder.
        user_options: the options the user gave.

    Returns:
        The run's number.
    """
    folder = _new_folder(job)
    number = int(folder.name)
    for name in names:
        _link(job / name, folder / name)
    # For who imports this run's folder by itself; the working photos lie outside.
    views = [{**view, "file": None} for view in manifest["views"]]
    write_json(folder / MANIFEST, {**manifest, "views": views})
    record = {"time": time.time(), "version": __version__, "figures": manifest["figures"], "given": user_options}
    write_json(folder / RECORD, record)
    write_json(job / MANIFEST, _below(manifest, f"{FOLDER}/{number}/"))
    return number


def _new_folder(job: Path) -> Path:
    number = max((run.number for run in list_runs(job)), default=0) + 1
    while True:
        folder = job / FOLDER / str(number)
        shutil.rmtree(folder, ignore_errors=True)  # half of a run that was killed here
        try:
            folder.mkdir(parents=True)
            return folder
        except FileExistsError:  # Windows: something in it is open
            number += 1


def list_runs(job: Path) -> list[Run]:
    """List the runs of a job that came to their end, oldest first; the last one is the job's present result."""
    names = [path.name for path in (job / FOLDER).glob("*") if path.is_dir()]
    numbers = sorted(int(name) for name in names if name.isdecimal() and name == str(int(name)))
    runs = (_read(job / FOLDER / str(number)) for number in numbers)
    return [run for run in runs if run is not None]


def current_run(job: Path) -> Path | None:
    """Return the folder of a job's present result; None where it has none."""
    runs = list_runs(job)
    return job / FOLDER / str(runs[-1].number) if runs else None


def renew_run(job: Path, names: Iterable[str]) -> None:
    """Bring files and folders of these names in a job's present result, if it has one, to what they are in the job
    folder now."""
    run = current_run(job)
    if run is None:
        return
    for name in names:
        there = run / name
        if there.is_dir():
            shutil.rmtree(there)
        else:
            there.unlink(missing_ok=True)
        _link(job / name, there)


def delivered(job: Path) -> bool:
    """Tell whether every file is there that the job's ``deliver.json`` names."""
    try:
        manifest = json.loads((job / MANIFEST).read_text(encoding="utf-8"))
        return all((job / manifest[key]).exists() for key in _FILES if manifest.get(key))
    except (OSError, ValueError, AttributeError, TypeError, RecursionError):
        return False


def remove_runs(job: Path, numbers: Iterable[int]) -> list[Run]:
    """Remove runs; what removing them freed is in each one's ``size``.

    Raises:
        BadInput: there is no run of a number, or it is the present result; nothing is removed then.
    """
    runs = {run.number: run for run in list_runs(job)}
    chosen = sorted(set(numbers))
    for number in chosen:
        if number not in runs:
            raise BadInput(f"The job in '{job}' has no run {number}; 'mgf clean' without a number lists them.")
        if number == max(runs):
            raise BadInput(f"Run {number} is the present result of the job in '{job}'; it stays.")
    for number in chosen:
        (job / FOLDER / str(number) / RECORD).unlink()  # first: what is left of it is no run any more
        shutil.rmtree(job / FOLDER / str(number))
    return [runs[number] for number in chosen]


def _read(folder: Path) -> Run | None:
    try:
        record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
        figures, user_options = dict(record["figures"]), dict(record["given"])
        moment = float(record["time"])
        time.localtime(moment)
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return None
    states = [path.stat() for path in folder.rglob("*") if path.is_file()]
    return Run(int(folder.name), moment, figures, user_options, sum(s.st_size for s in states if s.st_nlink < 2))


def _link(source: Path, target: Path) -> None:
    """Give a file, or each file below a folder, a second name; a copy where that cannot be."""
    if source.is_dir():
        for path in source.iterdir():
            _link(path, target / path.name)
    elif source.exists():
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            os.link(source, target)
        except OSError:  # FAT, some network drives
            shutil.copy2(source, target)


def _below(manifest: dict[str, Any], place: str) -> dict[str, Any]:
    """Return the manifest with its results named below ``place``."""
    named = {key: place + manifest[key] for key in _FILES if manifest.get(key)}
    views = [{**v, "render": place + v["render"] if v["render"] else None} for v in manifest["views"]]
    return {**manifest, **named, "views": views}
