# SPDX-License-Identifier: GPL-3.0-or-later
"""The job folder: what was asked for, which stages are done, and the lock that keeps two processes apart.

A stage is done when ``job.json`` holds its key (:mod:`mgf_engine.stage_keys`). The inputs are looked at once, when the
job is opened: what changes while it runs is for the next run to notice.
"""

from __future__ import annotations

import os
import shutil
from functools import partial
from pathlib import Path
from typing import Any

from filelock import FileLock

from mgf_engine import __version__
from mgf_engine.config import as_dict, make_config
from mgf_engine.errors import BadInput
from mgf_engine.inputs import Inputs, read_inputs
from mgf_engine.job_folder import (
    FORMAT,
    acquire,
    check_folder,
    check_inputs,
    check_no_file,
    check_one_guide,
    make_folder,
    read_job,
)
from mgf_engine.runs import delivered
from mgf_engine.stage_keys import TABLES, adjusts_to_control, stage_keys
from mgf_engine.stages import MANIFEST, STAGE_NAMES, STAGES, Stage, stage_named
from mgf_engine.system import atomic_path, sweep, write_json

#: The clicks that the masks in the folder are made from.
CLICKS = "prompts.json"


class Job:
    """One job folder, open and locked by this process; use as a context manager.

    Attributes:
        folder: the job folder.
        source: the user's COLMAP scene or photo folder.
        prompts: the user's prompts file, or None.
        masks: the user's folder of masks, or None.
        given: the options the user gave, name -> value.
        config: the validated options.
        inputs: what the files of source, prompts and masks were when the job was opened.
        keys: the key each stage has with these inputs and options.
        stages: stage name -> key, seconds, cpu_seconds, peak_memory, figures, warnings, for the stages that are done.
    """

    inputs: Inputs
    keys: dict[str, str]

    def __init__(
        self,
        folder: Path,
        lock: FileLock,
        source: Path,
        prompts: Path | None,
        masks: Path | None,
        given: dict[str, Any],
    ) -> None:
        self.folder, self.source, self.prompts, self.masks = folder, source, prompts, masks
        self.given, self.config = given, make_config(given)
        self.stages: dict[str, dict[str, Any]] = {}
        self._lock = lock

    @classmethod
    def start(
        cls,
        folder: Path,
        source: Path | None = None,
        prompts: Path | None = None,
        masks: Path | None = None,
        given: dict[str, Any] | None = None,
        *,
        resume: bool = False,
        own: dict[str, Any] | None = None,
    ) -> Job:
        """Make a job folder, or take up the one that is there when ``resume`` is set.

        A resumed job keeps the inputs and options it was started with where no new ones are given; new clicks take the
        place of masks given before.

        Args:
            folder: of the job; made if missing.
            source: folder of the scene; None keeps that of the job.
            prompts: file of clicks.
            masks: folder of the user's own masks.
            given: options as the user gave them.
            resume: continue the job in the folder.
            own: options in the place of those that the job in the folder was made with; None keeps these.

        Raises:
            BadInput: an option or input is wrong, the folder cannot be written, holds something else or another
                job, or is in use.
        """
        check_no_file(folder)
        folder = folder.resolve()  # as the inputs are, so that the job's own files are known among them
        lock = FileLock(str(folder / ".lock"))
        plan = partial(cls._plan, folder, lock, source, prompts, masks, _with_whole_paths(given or {}), resume, own)
        plan()  # refuses before anything is made
        make_folder(folder)
        acquire(lock, folder)
        try:
            job = plan()  # again: another process may have finished stages before it released the lock
            tables = {name: value for name in TABLES if (value := getattr(job.config, name))}
            job.inputs = read_inputs(job.source, job.prompts, job.masks, folder, tables)
            job.keys = stage_keys(job.config, job.inputs)
            sweep(folder)
            job.save()
        except BaseException:
            lock.release()
            raise
        return job

    @classmethod
    def _plan(
        cls,
        folder: Path,
        lock: FileLock,
        source: Path | None,
        prompts: Path | None,
        masks: Path | None,
        given: dict[str, Any],
        resume: bool,
        own: dict[str, Any] | None,
    ) -> Job:
        """Return the job that :meth:`start` asks for, with what the folder's job file says; nothing is written."""
        stages: dict[str, dict[str, Any]] = {}
        check_one_guide(prompts, masks)
        if resume and (source is None or (folder / "job.json").exists()):
            earlier = read_job(folder)
            source, stages = source or Path(earlier["source"]), earlier["stages"]
            if prompts is None and masks is None:  # what is given anew is meant to be used, alone
                prompts, masks = _path(earlier["prompts"]), _path(earlier["masks"])
            given = {**(earlier["given"] if own is None else own), **given}
        if source is None:
            raise BadInput("Give the scene to reconstruct: a COLMAP folder or a folder of photos.")
        check_inputs(source, prompts, masks, folder / CLICKS)
        job = cls(folder, lock, source.resolve(), _resolved(prompts), _resolved(masks), given)
        check_folder(folder, job.source, resume)
        job.stages = stages
        return job

    def __enter__(self) -> Job:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the folder for other processes."""
        self._lock.release()

    def path(self, *parts: str) -> Path:
        """Return a path inside the job folder."""
        return self.folder.joinpath(*parts)

    def done(self, stage: str) -> bool:
        """Tell whether the stage ran with the job's inputs and options."""
        return self.stages.get(stage, {}).get("key") == self.keys[stage]

    def lost(self, until: str) -> set[str]:
        """Return stages up to ``until`` that are done but whose results are gone and needed.

        Needed is what was asked for, what people take from the folder, and what a stage that has to run reads; the
        rest may be deleted.
        """
        lost, read = set[str](), {until}
        for stage in reversed(STAGES[: STAGE_NAMES.index(until) + 1]):
            done, name = self.done(stage.name), stage.name
            if done and (stage.taken or name in read) and not self._complete(stage):
                lost.add(name)
            if name in lost or not done:
                read.update(stage.reads)
        return lost

    def _complete(self, stage: Stage) -> bool:
        """Tell whether the stage's results are there, with those that an option asked for."""
        wanted = [files for option, files in stage.on_request.items() if getattr(self.config, option)]
        files = [*stage.proofs, *(name for names in wanted for name in names)]
        return all(self.path(name).exists() for name in files) and (MANIFEST not in files or delivered(self.folder))

    def forget(self, stage: str) -> None:
        """Drop the record of a stage, so that the next run does it again."""
        self.stages.pop(stage, None)
        self.save()

    def begin(self, stage: str) -> str:
        """Forget the stage and later ones of other options; remove outputs of other options. Returns the stage's key.

        The checkpoints of an unfinished field stay when they belong to the same key (the trainer resumes from them).
        """
        keys = self.keys
        self.stages = {name: entry for name, entry in self.stages.items() if entry["key"] == keys[name]}
        self.forget(stage)
        key, started = keys[stage], self.path(".started-" + stage)
        same = started.exists() and started.read_bytes() == key.encode()
        if not same:
            for name in stage_named(stage).written:
                _remove(self.path(name))
            started.write_text(key)
        return key

    def keep_clicks(self) -> None:
        """Write the clicks, as they were when the job was opened, beside the masks that are made from them."""
        if self.inputs.clicks is None:
            self.path(CLICKS).unlink(missing_ok=True)  # of masks made before
        else:
            with atomic_path(self.path(CLICKS)) as temporary:
                temporary.write_bytes(self.inputs.clicks.content)

    def finish(
        self, stage: str, key: str, seconds: float, cpu: float, peak: int, figures: dict[str, Any], warnings: list[str]
    ) -> None:
        """Record the stage as done, with its cost (wall and CPU seconds, bytes), figures and warnings.

        Args:
            stage: its name.
            key: what it was made from, as :meth:`begin` returned it.
            seconds: wall time.
            cpu: CPU time, seconds.
            peak: peak memory, bytes.
            figures: for the report.
            warnings: sentences the user has seen.
        """
        self.stages[stage] = {
            "key": key, "seconds": round(seconds, 2), "cpu_seconds": round(cpu, 2), "peak_memory": peak,
            "figures": figures, "warnings": warnings,
        }  # fmt: skip
        self.save()

    def save(self) -> None:
        """Write ``job.json``."""
        write_json(
            self.path("job.json"),
            {
                "format": FORMAT,
                "version": __version__,
                "source": str(self.source),
                "prompts": None if self.prompts is None else str(self.prompts),
                "masks": None if self.masks is None else str(self.masks),
                "given": self.given,
                "config": as_dict(self.config),
                "stages": self.stages,
            },
        )

    @property
    def adjusts_to_control(self) -> bool:
        """Whether control points move the cameras, so that the scene depends on them."""
        return adjusts_to_control(self.config)


def _with_whole_paths(given: dict[str, Any]) -> dict[str, Any]:
    """Make the paths of options that name files absolute: a job may be resumed from another folder."""
    return {k: str(Path(v).resolve()) if k in TABLES and isinstance(v, str) and v else v for k, v in given.items()}


def _path(text: str | None) -> Path | None:
    return None if text is None else Path(text)


def _resolved(path: Path | None) -> Path | None:
    return None if path is None else path.resolve()


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    elif path.exists() or path.is_symlink():
        os.unlink(path)
