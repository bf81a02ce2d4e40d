# SPDX-License-Identifier: GPL-3.0-or-later
"""Write a folder of deliverables of a finished job atomically: it replaces the earlier one when it is complete."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mgf_engine.errors import BadInput
from mgf_engine.files.atomic import atomic_folder
from mgf_engine.jobs.job_folder import locked, read_job
from mgf_engine.messages import Reporter
from mgf_engine.options.config import Config
from mgf_engine.system.machine import cpu_seconds, peak_memory


@dataclass
class Cost:
    """CPU seconds of each deliverable, and the process's largest memory in bytes after it."""

    seconds: dict[str, float] = field(default_factory=dict)
    memory: dict[str, int] = field(default_factory=dict)

    @contextmanager
    def of(self, name: str) -> Iterator[None]:
        """Count what happens meanwhile."""
        begun = cpu_seconds()
        yield
        self.seconds[name] = round(self.seconds.get(name, 0.0) + cpu_seconds() - begun, 2)
        self.memory[name] = peak_memory()


@dataclass(kw_only=True)
class Deliverables:
    """What the parts of a run share that makes files of a finished job.

    Attributes:
        config: options of the algorithms.
        folder: where files go.
        reporter: for progress, warnings and the request to cancel.
        cost: of each deliverable.
        files: name -> what is known about it, for the folder's index.
    """

    config: Config
    folder: Path
    reporter: Reporter
    cost: Cost
    files: dict[str, dict[str, Any]] = field(default_factory=dict)

    def add(self, name: str, **facts: Any) -> Path:
        """Return the path of a file to write, on record with what is known about it."""
        self.files[name] = facts
        return self.folder / name

    def send(self, folder: Path, **figures: int) -> None:
        """Send the files, which are in their folder now, and figures as the result of the command."""
        files = {name: str(folder / name) for name in self.files}
        seconds = sum(self.cost.seconds.values())
        shown = {**figures, "CPU seconds": round(seconds, 1) if seconds < 10 else round(seconds)}
        self.reporter.send("result", path=str(folder), files=files, figures=shown)


@contextmanager
def replace_outputs(
    job: Path, folder: Path, index: str, what: str, reporter: Reporter, complete: bool = True
) -> Iterator[Path]:
    """Lock a finished job, and return a folder for what is made of it, see :func:`atomic_folder`.

    Args:
        job: its folder.
        folder: where the outputs go in the end; an earlier run's are replaced.
        index: name of the file that lists them, by which an earlier run is known.
        what: they are, in one word.
        reporter: takes the warning that a run for only a part of them replaces all.
        complete: whether all of them are made.

    Raises:
        BadInput: there is no job, or the folder holds other files or cannot be written.
    """
    check_output_folder(folder, index, what)
    if not complete:
        warn_of_replacement(folder, index, reporter)
    read_job(job)  # or the lock would be left in a folder without a job
    with locked(job), ExitStack() as stack:
        try:
            beside = stack.enter_context(atomic_folder(folder))
        except OSError as error:
            raise BadInput(
                f"Cannot write to '{folder.parent}' ({error.strerror}); give --out another folder."
            ) from error
        yield beside


def check_output_folder(folder: Path, index: str, what: str) -> None:
    """Refuse a folder that holds anything else than an earlier run.

    Args:
        folder: that the run is to write.
        index: name of the file that an earlier run left there.
        what: such a folder holds, in one word.

    Raises:
        BadInput: it is a file, or holds other files.
    """
    if folder.exists() and not folder.is_dir():
        raise BadInput(f"The output '{folder}' is a file; give a folder.")
    if folder.is_dir() and any(folder.iterdir()) and not (folder / index).is_file():
        raise BadInput(f"The folder '{folder}' is not empty and holds no {what}; give an empty or new folder.")


def warn_of_replacement(folder: Path, index: str, reporter: Reporter) -> None:
    """Warn before a run of which only a part was asked for that it replaces everything an earlier run made.

    Args:
        folder: of both runs.
        index: name of the file that the earlier run left there.
        reporter: takes the warning.
    """
    if (folder / index).is_file():
        count = sum(1 for _ in folder.iterdir())
        reporter.warning(
            f"This run takes the place of the earlier one in '{folder}' ({count} files); stop it and give --out to "
            "keep them."
        )
