# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks of a job folder: read its ``job.json``, lock it, and refuse unsuitable folders before anything is written."""

from __future__ import annotations

import json
import logging
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from mgf_engine.errors import BadInput, reason
from mgf_engine.options.algorithms import is_algorithm_option
from mgf_engine.options.config import Config, make_config
from mgf_engine.stages import STAGE_NAMES

log = logging.getLogger("mgf")
FORMAT = 1  # of job.json
#: Files of a job that was refused before its first stage was done.
_OF_A_REFUSED_JOB = {"job.json", "log.txt", ".lock", f".started-{STAGE_NAMES[0]}"}


def read_job(folder: Path) -> dict[str, Any]:
    """Read the contents of a job's ``job.json``.

    Raises:
        BadInput: there is no job, it cannot be read, or it was written by a newer version.
    """
    path = folder / "job.json"
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if not all(isinstance(data[key], dict) for key in ("stages", "given")):
            raise TypeError("stages or given")
        inputs = {"source": str, "prompts": str | None, "masks": str | None}
        if not all(isinstance(data[key], kind) for key, kind in inputs.items()):
            raise TypeError("source, prompts or masks")
        data["format"]
        _check_stages(data["stages"])
    except FileNotFoundError as error:
        raise BadInput(f"'{folder}' holds no job; give the folder that 'mgf reconstruct' made.") from error
    except NotADirectoryError as error:
        raise BadInput(f"'{folder}' is a file; give the job's folder.") from error
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise BadInput(f"The job file '{path}' cannot be read ({reason(error)}); start in a new folder.") from error
    if data["format"] != FORMAT:
        raise BadInput(f"The job in '{folder}' was written by another version of MGF; start in a new folder.")
    return data


def with_algorithms_of_job(folder: Path, given: Mapping[str, Any], warn: Callable[[str], None] = log.warning) -> Config:
    """Return the options of algorithms for a command on a finished job: the job's own, less those given.

    Args:
        given: ``section.name`` -> value; these win.
        warn: takes a sentence about options of the job that this version does not know.

    Raises:
        BadInput: as :func:`read_job`.
    """
    own = {k: v for k, v in read_job(folder)["given"].items() if k == "preset" or is_algorithm_option(k)}
    return make_config({**known_options(own, warn), **given})


def known_options(given: Mapping[str, Any], warn: Callable[[str], None]) -> dict[str, Any]:
    """Return those of a finished job's options that this version takes; a sentence names the others."""
    known, unknown = {}, []
    for name, value in given.items():
        try:
            make_config({name: value})
            known[name] = value
        except BadInput:
            unknown.append(name)
    if unknown:
        warn(f"The job was made by another version of MGF; its options {', '.join(unknown)} are passed over here.")
    return known


def _check_stages(stages: dict[str, Any]) -> None:
    """Check every stage's record as :meth:`mgf_engine.jobs.job.Job.finish` writes it; TypeError or KeyError where it is
    not."""
    for name, entry in stages.items():
        kinds = {"key": str, "seconds": int | float, "peak_memory": int, "figures": dict, "warnings": list}
        if name not in STAGE_NAMES or not all(isinstance(entry[key], kind) for key, kind in kinds.items()):
            raise TypeError(f"stage {name}")


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock the job folder, so that nobody else works in it meanwhile.

    Raises:
        BadInput: somebody does, or the folder cannot be locked.
    """
    if folder.is_file():
        raise BadInput(f"'{folder}' is a file; give the job's folder.")
    lock = FileLock(str(folder.resolve() / ".lock"))
    acquire(lock, folder)
    try:
        yield
    finally:
        lock.release()


def acquire(lock: FileLock, folder: Path) -> None:
    """Take the lock of a job folder.

    Raises:
        BadInput: another process has it, or the folder cannot be locked.
    """
    try:
        lock.acquire(timeout=0)
    except Timeout as error:
        raise BadInput(f"The job folder '{folder}' is in use by another process; wait or stop it.") from error
    except (OSError, NotImplementedError) as error:
        why = getattr(error, "strerror", error)
        raise BadInput(f"Cannot lock '{folder}' ({why}); give a folder on another file system.") from error


def make_folder(folder: Path) -> None:
    """Make the folder and check that it can be written to.

    Raises:
        BadInput: it cannot.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".lock"
        if probe.is_symlink():  # would be written through, and the lock itself does not follow links
            raise BadInput(f"'{probe}' is a symbolic link, where a job's own file has to be; remove it and try again.")
        with probe.open("ab"):
            pass
    except OSError as error:
        raise BadInput(f"Cannot write to '{folder}' ({error.strerror}); give a folder you may write to.") from error


def check_no_file(folder: Path) -> None:
    """Check that the output is no file.

    Raises:
        BadInput: it is.
    """
    if folder.exists() and not folder.is_dir():
        raise BadInput(f"The output '{folder}' is a file; give a folder.")


def check_inputs(source: Path, prompts: Path | None, masks: Path | None, kept: Path) -> None:
    """Check that the user's files are there.

    Args:
        source: the scene's folder.
        prompts: the clicks; None where there are none.
        masks: the folder of the user's own masks; None where there are none.
        kept: the clicks that the job keeps, named where the user's own are gone.

    Raises:
        BadInput: one is missing, or of another kind.
    """
    if prompts is not None and not prompts.exists() and kept.is_file():
        raise BadInput(
            f"The prompts file '{prompts}' does not exist; check the path, or give the clicks that the job kept: "
            f"--prompts '{kept}'."
        )
    for path, what in ((source, "scene"), (prompts, "prompts file"), (masks, "mask folder")):
        if path is not None and not path.exists():
            raise BadInput(f"The {what} '{path}' does not exist; check the path.")
    if _holds_job(source):
        raise BadInput(f"'{source}' is a job folder; give the scene of that job, '{read_job(source)['source']}'.")
    if prompts is not None and prompts.is_dir():
        raise BadInput(f"The prompts file '{prompts}' is a folder; give a file.")
    if masks is not None and not masks.is_dir():
        raise BadInput(f"The mask folder '{masks}' is a file; give a folder with one PNG per photo.")


def _holds_job(folder: Path) -> bool:
    """Tell whether a folder is that of a job of this version."""
    try:
        return bool(read_job(folder))
    except BadInput:
        return False


def check_one_guide(prompts: Path | None, masks: Path | None) -> None:
    """Check that no clicks are given beside masks, which would be used alone.

    Raises:
        BadInput: both are given.
    """
    if prompts is not None and masks is not None:
        raise BadInput("Give either --prompts or --masks, not both: where there are masks, clicks are not used.")


def check_folder(folder: Path, source: Path, resume: bool) -> None:
    """Check that the folder is empty, or holds the job of this scene; a job that did nothing yet counts as empty.

    Where the scene of the job is gone, this one may be it, moved: :func:`mgf_engine.jobs.job.check_moved` compares.

    Raises:
        BadInput: it is the scene itself, or holds something else; or the job is not to be resumed.
    """
    if same_folder(folder, source):
        raise BadInput("The output folder is the scene itself; give another folder.")
    if (folder / "job.json").exists():
        if did_nothing(folder):
            return
        other = Path(read_job(folder)["source"])
        if other.exists() and not same_folder(other, source):
            raise another_scene(folder, other)
        if not resume:
            raise BadInput(f"'{folder}' already holds a job; add --resume to continue it, or give another folder.")
    elif folder.exists() and any(p.name != ".lock" for p in folder.iterdir()):
        raise BadInput(f"The output folder '{folder}' is not empty and holds no job; give an empty or new folder.")


def another_scene(folder: Path, other: Path) -> BadInput:
    """Return the refusal of a folder that holds the job of the scene ``other``."""
    return BadInput(f"'{folder}' holds the job of another scene ('{other}'); give another folder.")


def did_nothing(folder: Path) -> bool:
    """Tell whether the job in the folder was refused before it had done anything: nothing can be lost there."""
    return not read_job(folder)["stages"] and all(p.name in _OF_A_REFUSED_JOB for p in folder.iterdir())


def remove_refused(folder: Path) -> None:
    """Remove a job's folder again, if the job was refused before it had done anything."""
    with suppress(BadInput, OSError):
        if not (folder / "job.json").exists():  # refused before it was written
            (folder / ".lock").unlink(missing_ok=True)
            folder.rmdir()
        elif did_nothing(folder):
            shutil.rmtree(folder)


def same_folder(one: Path, other: Path) -> bool:
    """Tell whether two paths are one folder, also where the case of letters does not count or a drive has two names."""
    try:
        return one == other or os.path.samefile(one, other)
    except OSError:  # one of them is not there
        return False
