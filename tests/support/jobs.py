# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs of small scenes, begun and run to the end; and jobs that do nothing: no photos, stages called finished."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from mgf_engine.cli.main import main
from mgf_engine.jobs.job import Job
from mgf_engine.stages import STAGE_NAMES, stage_named

ENVIRONMENT = {**os.environ, "OMP_WAIT_POLICY": "PASSIVE"}


def start(*args: object) -> subprocess.Popen:
    command = [sys.executable, "-m", "mgf_engine", *map(str, args), "--progress", "json"]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT)


def finish(run: subprocess.Popen) -> list[dict]:
    out, err = run.communicate(timeout=400)
    assert "Traceback" not in err, err
    return [json.loads(line) for line in out.splitlines()]


def run_here(capsys: pytest.CaptureFixture[str], *args: object) -> tuple[int, list[dict]]:
    """Exit code and messages of a command in this process, for what is over sooner than a process has started."""
    code = main([*map(str, args), "--progress", "json"])
    said = capsys.readouterr()
    assert "Traceback" not in said.err, said.err
    return code, [json.loads(line) for line in said.out.splitlines()]


def write_photo_folder(folder: Path) -> Path:
    """Write a folder with one file named like a photo; returns it."""
    (folder / "images").mkdir(parents=True)
    (folder / "images" / "a.jpg").write_bytes(b"x")
    return folder


def finish_all(job: Job) -> None:
    """Call all stages of a job finished."""
    for stage in STAGE_NAMES:
        job.finish(stage, job.keys[stage], 1.0, 2.0, 1, {}, [])


def redone(folder: Path, change: Callable[[], object], *inputs: Path | None) -> list[str]:
    """Stages that a change of the inputs makes run again, of a job that was finished before."""
    with Job.start(folder, *inputs, resume=True) as job:
        finish_all(job)
        change()
        assert all(job.done(stage) for stage in STAGE_NAMES)  # the run that is open ends as it began
    with Job.start(folder, resume=True) as job:
        return [stage for stage in STAGE_NAMES if not job.done(stage)]


def leave_results(job: Job) -> None:
    """Write a file in place of each result of the stages."""
    for stage in STAGE_NAMES:
        for name in (*stage_named(stage).required_outputs, *stage_named(stage).optional_outputs.get("texture", ())):
            job.path(name).parent.mkdir(parents=True, exist_ok=True)
            job.path(name).write_bytes(b"{}")
