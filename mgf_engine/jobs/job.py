# SPDX-License-Identifier: GPL-3.0-or-later
"""A job and its folder: inputs, options, the stages that are done, and a lock against a second process.

A stage is done when ``job.json`` holds its current key (:mod:`mgf_engine.jobs.stage_keys`). The inputs are read once,
when the job is opened: a change while the job runs takes effect in the next run.
"""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from filelock import FileLock

from mgf_engine import __version__
from mgf_engine.errors import BadInput
from mgf_engine.files.atomic import atomic_path, sweep, write_json
from mgf_engine.jobs.inputs import Inputs, read_inputs
from mgf_engine.jobs.job_folder import (
    FORMAT,
    acquire,
    another_scene,
    check_folder,
    check_inputs,
    check_no_file,
    check_one_guide,
    did_nothing,
    make_folder,
    read_job,
    same_folder,
)
from mgf_engine.jobs.runs import delivered
from mgf_engine.jobs.stage_keys import TABLES, adjusts_to_control, stage_keys
from mgf_engine.options.config import as_dict, make_config
from mgf_engine.scene.validation import ValidationOptions
from mgf_engine.stages import MANIFEST, STAGE_NAMES, STAGES, Stage, stage_named

#: Copy of the clicks that the masks in the folder are made from.
CLICKS = "prompts.json"


@dataclass(frozen=True)
class JobRequest:
    """What :meth:`Job.start` is asked for; its arguments, with whole paths of the folder and of files in options."""

    folder: Path
    source: Path | None
    prompts: Path | None
    masks: Path | None
    user_options: dict[str, Any]
    resume: bool
    earlier_options: dict[str, Any] | None


class Job:
    """One job folder, open and locked by this process; use as a context manager.

    Attributes:
        folder: the job folder.
        source: the user's COLMAP scene or photo folder.
        prompts: the user's prompts file, or None.
        masks: the user's folder of masks, or None.
        user_options: the options that the user set, name -> value.
        config: the validated options.
        inputs: identity of the input files when the job was opened.
        keys: stage name -> its key with these inputs and options.
        stages: name of each stage that is done -> key, seconds, cpu_seconds, peak_memory, figures, warnings.
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
        user_options: dict[str, Any],
    ) -> None:
        self.folder, self.source, self.prompts, self.masks = folder, source, prompts, masks
        self.user_options, self.config = user_options, make_config(user_options)
        self.stages: dict[str, dict[str, Any]] = {}
        self._lock = lock

    @classmethod
    def start(
        cls,
        folder: Path,
        source: Path | None = None,
        prompts: Path | None = None,
        masks: Path | None = None,
        user_options: dict[str, Any] | None = None,
        *,
        resume: bool = False,
        earlier_options: dict[str, Any] | None = None,
    ) -> Job:
        """Create a job folder, or continue the job in it with ``resume``.

        A resumed job keeps its inputs and options unless new ones are given; new clicks replace masks given before,
        and the reverse.

        Args:
            folder: of the job; created if missing.
            source: folder of the scene; None keeps that of the job.
            prompts: file of clicks.
            masks: folder of the user's own masks.
            user_options: options that the user sets now.
            resume: continue the job in the folder.
            earlier_options: replaces the options that the user set in earlier runs of the job; None keeps these.

        Raises:
            BadInput: an option or input is wrong, the folder cannot be written, holds something else or another
                job, or is in use.
        """
        check_no_file(folder)
        folder = folder.resolve()  # like the inputs, so that files of the job are recognised among them
        lock = FileLock(str(folder / ".lock"))
        user_options = _with_whole_paths(user_options or {})
        request = JobRequest(folder, source, prompts, masks, user_options, resume, earlier_options)
        cls._plan(request, lock)  # raises before anything is written
        make_folder(folder)
        acquire(lock, folder)
        try:
            job = cls._plan(request, lock)  # again: another process may have finished stages meanwhile
            tables = {name: value for name in TABLES if (value := getattr(job.config, name))}
            # More than the scene stage leaves out it would refuse, but only when the results of before are gone.
            most = job.config.algorithm(ValidationOptions).most_unreadable
            job.inputs = read_inputs(job.source, job.prompts, job.masks, folder, tables, most)
            job.keys = stage_keys(job.config, job.inputs)
            check_moved(folder, job.source, job.inputs)
            sweep(folder)
            job.save()
        except BaseException:
            lock.release()
            raise
        return job

    @classmethod
    def _plan(cls, request: JobRequest, lock: FileLock) -> Job:
        """Check a request and make the job, with the record of earlier runs; write nothing."""
        folder, stages = request.folder, dict[str, dict[str, Any]]()
        check_one_guide(request.prompts, request.masks)
        if request.resume and (request.source is None or (folder / "job.json").exists()):
            earlier = read_job(folder)
            request, stages = _continued(request, earlier), earlier["stages"]
        source, prompts, masks = request.source, request.prompts, request.masks
        if source is None:
            raise BadInput("Give the scene to reconstruct: a COLMAP folder or a folder of photos.")
        check_inputs(source, prompts, masks, folder / CLICKS)
        job = cls(folder, lock, source.resolve(), _resolved(prompts), _resolved(masks), request.user_options)
        check_folder(folder, job.source, request.resume)
        job.stages = stages
        return job

    def __enter__(self) -> Job:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the lock of the folder."""
        self._lock.release()

    def path(self, *parts: str) -> Path:
        """Return a path inside the job folder."""
        return self.folder.joinpath(*parts)

    def done(self, stage: str) -> bool:
        """Tell whether the stage has run with the present inputs and options."""
        return self.stages.get(stage, {}).get("key") == self.keys[stage]

    def missing_results(self, until: str) -> set[str]:
        """Return stages up to ``until`` that are done, but whose results have been deleted and are needed.

        Results are needed of ``until``, of user-facing stages, and of stages that a stage which has to run reads.
        """
        missing, read = set[str](), {until}
        for stage in reversed(STAGES[: STAGE_NAMES.index(until) + 1]):
            done, name = self.done(stage.name), stage.name
            if done and (stage.user_facing or name in read) and not self._complete(stage):
                missing.add(name)
            if name in missing or not done:
                read.update(stage.reads)
        return missing

    def _complete(self, stage: Stage) -> bool:
        """Tell whether all required outputs of the stage exist, and those that options ask for."""
        wanted = [files for option, files in stage.optional_outputs.items() if getattr(self.config, option)]
        files = [*stage.required_outputs, *(name for names in wanted for name in names)]
        return all(self.path(name).exists() for name in files) and (MANIFEST not in files or delivered(self.folder))

    def forget(self, stage: str) -> None:
        """Delete the record of a stage, so that the next run repeats it."""
        self.stages.pop(stage, None)
        self.save()

    def begin(self, stage: str) -> str:
        """Prepare the folder for a run of the stage, and return the stage's key.

        Records of stages with outdated keys are deleted, and so are outputs of this stage. Outputs of an interrupted
        run with the same key stay: the trainer resumes from its checkpoints.
        """
        keys = self.keys
        self.stages = {name: entry for name, entry in self.stages.items() if entry["key"] == keys[name]}
        self.forget(stage)
        key, started = keys[stage], self.path(".started-" + stage)
        same = started.exists() and started.read_bytes() == key.encode()
        if not same:
            for name in stage_named(stage).output_paths:
                _remove(self.path(name))
            started.write_text(key)
        return key

    def keep_clicks(self) -> None:
        """Write the clicks, as read when the job was opened, to the job folder."""
        if self.inputs.clicks is None:
            self.path(CLICKS).unlink(missing_ok=True)  # clicks of an earlier run
        else:
            with atomic_path(self.path(CLICKS)) as temporary:
                temporary.write_bytes(self.inputs.clicks.content)

    def finish(
        self, stage: str, key: str, seconds: float, cpu: float, peak: int, figures: dict[str, Any], warnings: list[str]
    ) -> None:
        """Record the stage as done.

        Args:
            stage: its name.
            key: as :meth:`begin` returned it.
            seconds: wall time.
            cpu: CPU time, seconds.
            peak: peak memory, bytes.
            figures: numbers for the report, name -> value.
            warnings: sentences shown to the user.
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
                "given": self.user_options,
                "config": as_dict(self.config),
                "stages": self.stages,
            },
        )

    @property
    def adjusts_to_control(self) -> bool:
        """Whether the cameras are adjusted to control points, so that the scene depends on these."""
        return adjusts_to_control(self.config)


def _continued(request: JobRequest, earlier: dict[str, Any]) -> JobRequest:
    """Return the request for a job that goes on: what is not given now is as in the record of earlier runs.

    Raises:
        BadInput: no scene is given, and that of earlier runs does not exist.
    """
    source, options = request.source, request.earlier_options
    if source is None:
        source = Path(earlier["source"])
        if not source.exists():
            raise BadInput(f"The scene '{source}' of this job does not exist; give the folder that it was moved to.")
    guides = (request.prompts, request.masks)
    if guides == (None, None):  # new clicks or masks replace both
        guides = _path(earlier["prompts"]), _path(earlier["masks"])
    options = {**(earlier["given"] if options is None else options), **request.user_options}
    return replace(request, source=source, prompts=guides[0], masks=guides[1], user_options=options)


def check_moved(folder: Path, source: Path, inputs: Inputs) -> None:
    """Check that a job goes on with its own scene, where that lies in another place than before.

    Args:
        folder: the job folder.
        source: the scene that was given.
        inputs: identity of its files.

    Raises:
        BadInput: it is another scene.
    """
    record = read_job(folder) if (folder / "job.json").exists() else None
    if record is None or did_nothing(folder) or same_folder(Path(record["source"]), source):
        return
    begun = folder / ".started-scene"
    last = begun.read_text("utf-8", "replace") if begun.exists() else None
    known = record["stages"].get("scene", {}).get("key", last)
    if known != stage_keys(make_config(record["given"]), inputs)["scene"]:
        raise another_scene(folder, Path(record["source"]))


def _with_whole_paths(options: dict[str, Any]) -> dict[str, Any]:
    """Make the paths of options that name files absolute: a job may be resumed from another folder."""
    return {k: str(Path(v).resolve()) if k in TABLES and isinstance(v, str) and v else v for k, v in options.items()}


def _path(text: str | None) -> Path | None:
    return None if text is None else Path(text)


def _resolved(path: Path | None) -> Path | None:
    return None if path is None else path.resolve()


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    elif path.exists() or path.is_symlink():
        os.unlink(path)
