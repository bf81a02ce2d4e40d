# SPDX-License-Identifier: GPL-3.0-or-later
"""Run the job of one building of a town: ``python -m mgf_engine.town.worker buildings/ID``, called by Snakemake.

The job is made in this process, so that nothing is left of it when the process is killed. ``status.json`` says where it
is; ``done.json`` is written last of all.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import select
import signal
import sys
import threading
import time
import traceback
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mgf_engine.errors import EXIT_BAD_INPUT, EXIT_CANCELLED, EXIT_DONE, EXIT_FAULT, BadInput, explain
from mgf_engine.files.atomic import json_text, write_json
from mgf_engine.messages import Message, Reporter
from mgf_engine.options.config import make_config

if TYPE_CHECKING:
    from mgf_engine.jobs.job import Job

STATUS, DONE, PICTURE, JOB = "status.json", "done.json", "picture.jpg", "job"
#: What a second attempt makes smaller: about half of the memory.
SMALLER, LEAST_SIDE, SMALL_TEXTURE = 0.7, 300, 2048
_PAUSE, _PATIENCE = 1.0, 120.0  # seconds between two writings of the status; to wait for a job that is being stopped
WAITING, RUNNING, FINISHED, FAILED, STOPPED = "waiting", "running", "done", "failed", "stopped"


class Status:
    """What a building's job is at, written to ``status.json`` from its messages."""

    def __init__(self, path: Path, attempt: int) -> None:
        self.path, self._written = path, 0.0
        self.values: dict[str, Any] = {
            "state": RUNNING, "attempt": attempt, "pid": os.getpid(), "started": time.time(), "stage": "",
            "overall": 0.0, "text": "", "code": None, "seconds": 0.0, "warnings": [],
        }  # fmt: skip

    def __call__(self, message: Message) -> None:
        """Take in a message of the job."""
        kind = message["type"]
        if kind == "stage":
            self.values["stage"] = message["stage"]
        elif kind == "progress":
            self.values["overall"] = message["overall"]
        elif kind == "warning":
            self.values["warnings"].append(message["text"])
        if kind in ("stage", "progress", "warning") and time.monotonic() - self._written > _PAUSE:
            self.write()

    def write(self, **changes: Any) -> None:
        """Write the status with some values changed."""
        self._written = time.monotonic()
        self.values.update(changes, seconds=round(time.time() - self.values["started"], 1))
        write_json(self.path, self.values)

    def write_last(self, **changes: Any) -> None:
        """Write how the job ended, on a full disk into the room that the file has already."""
        try:
            self.write(**changes)
        except OSError:
            with contextlib.suppress(OSError), self.path.open("r+b") as file:
                file.write(json_text(self.values).encode("utf-8"))
                file.truncate()


def options_of(row: dict[str, Any], attempt: int, threads: int) -> dict[str, Any]:
    """Return the options of a building's job; a second attempt works on smaller photos and takes a smaller texture."""
    user_options = {**row["options"], "threads": threads}
    config = make_config(user_options)
    side, texture = config.resolution, config.texture_size
    if attempt > 1:
        side, texture = max(min(LEAST_SIDE, side), round(SMALLER * side)), min(SMALL_TEXTURE, texture)
    # Both are named even at their defaults, since a resumed job keeps the options it had.
    return {**user_options, "resolution": side, "texture_size": texture}


def run_building(folder: Path, attempt: int, threads: int, solid: bool = False) -> int:
    """Make the job of one building; returns the exit code.

    Args:
        folder: of the building, in the town's.
        attempt: 2 where the first one failed.
        threads: of the job.
        solid: make the building's solid as well, here where all that it needs is loaded: its start took longer than it.
    """
    if _abandoned():
        return EXIT_CANCELLED
    earlier = read_record(folder / STATUS)
    if attempt > 1 and not worth_retrying(earlier):
        print(earlier["text"], file=sys.stderr)
        return int(earlier["code"])
    status = Status(folder / STATUS, attempt)
    reporter = Reporter(status)
    _watch(reporter)
    try:
        status.write()
        options = options_of(read_record(folder / "building.json"), attempt, threads)
        print(f"Attempt {attempt}: photos of {options['resolution']} px at most, {threads} threads.", flush=True)
        figures = _run(folder, options, reporter)
        if solid:
            _write_solid(folder)
        status.write(state=FINISHED, overall=1.0, code=EXIT_DONE)
        write_json(folder / DONE, {**figures, "seconds": status.values["seconds"], "attempt": attempt})
        return EXIT_DONE
    except (Exception, KeyboardInterrupt) as error:
        code, text = explain(error, again="run again", place=folder)
        if code == EXIT_FAULT:
            traceback.print_exception(error)
        status.write_last(state=STOPPED if code == EXIT_CANCELLED else FAILED, text=text, code=code)
        with contextlib.suppress(OSError):  # the log may be on the full disk
            print(text, file=sys.stderr, flush=True)
        return code


def worth_retrying(status: dict[str, Any]) -> bool:
    """Tell whether smaller photos may help: a fault, a kill or memory, but not clicks or photos that cannot be used."""
    refused = status.get("code") in (EXIT_BAD_INPUT, EXIT_CANCELLED)
    return not refused or "memory" in str(status.get("text", "")).lower()


def _open_job(folder: Path, user_options: dict[str, Any]) -> Job:
    """Open the job, once a job of a town that was killed has let go of its folder."""
    from mgf_engine.jobs.job import Job

    place, until = folder / JOB, time.monotonic() + _PATIENCE
    while True:
        resume = (place / "job.json").exists()
        try:
            return Job.start(place, folder / "scene", folder / "prompts.json", user_options=user_options, resume=resume)
        except BadInput as error:
            if "in use" not in str(error) or time.monotonic() > until:
                raise
            time.sleep(_PAUSE)


def _run(folder: Path, user_options: dict[str, Any], reporter: Reporter) -> dict[str, Any]:
    """Run the job of a building with these options; returns its figures for the town's table."""
    from mgf_engine.pipeline import run_job
    from mgf_engine.town.picture import draw_picture
    from mgf_engine.town.share import take_scene

    with _open_job(folder, user_options) as job:
        take_scene(job, folder.parents[1] / "scene" / "scene")
        run_job(job, reporter)
        draw_picture(job, folder / PICTURE)
        stages = job.stages
        return {
            "cpu_seconds": round(sum(float(entry["cpu_seconds"]) for entry in stages.values()), 1),
            "job_seconds": round(sum(float(entry["seconds"]) for entry in stages.values()), 1),
            "peak_memory": max(int(entry["peak_memory"]) for entry in stages.values()),
            "faces": stages["mesh"]["figures"].get("faces"),
            "confidence": stages["mesh"]["figures"].get("confidence"),
            "warnings": [text for entry in stages.values() for text in entry["warnings"]],
            "resolution": job.config.resolution,
        }  # fmt: skip


def _write_solid(folder: Path) -> None:
    from mgf_engine.town.solid import write_solid

    write_solid(folder, folder / JOB)


def read_record(path: Path) -> dict[str, Any]:
    """Read ``status.json``, ``done.json`` or ``building.json``; empty where it is missing or damaged."""
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return record if isinstance(record, dict) else {}


def _watch(reporter: Reporter) -> None:
    """Have SIGTERM, Ctrl-C and the end of whoever started the town stop the job; it goes on at the next call."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: reporter.cancel())

    def wait() -> None:
        with contextlib.suppress(OSError, ValueError):
            while sys.stdin.readline():
                pass
        reporter.cancel()

    if os.environ.get("MGF_TOWN_PIPE"):  # standard input is a pipe that mgf town holds open
        threading.Thread(target=wait, daemon=True).start()


def _abandoned() -> bool:
    """Tell whether the town that asks for this job has been killed already."""
    if os.name == "nt" or not os.environ.get("MGF_TOWN_PIPE"):
        return False
    return bool(select.select([sys.stdin], [], [], 0)[0])  # nothing is ever written: only its end can be read


def main() -> int:
    """Return the command of the Snakefile."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--attempt", type=int, default=1)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--solid", action="store_true")
    args = parser.parse_args()
    return run_building(args.folder.resolve(), args.attempt, args.threads, args.solid)


if __name__ == "__main__":
    sys.exit(main())
