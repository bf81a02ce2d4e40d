# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs that do nothing: a folder with a file that is no photo, and stages called finished."""

from __future__ import annotations

from pathlib import Path

from mgf_engine.job import Job
from mgf_engine.stages import STAGE_NAMES


def write_photo_folder(folder: Path) -> Path:
    """Write a folder with one file named like a photo; returns it."""
    (folder / "images").mkdir(parents=True)
    (folder / "images" / "a.jpg").write_bytes(b"x")
    return folder


def finish_all(job: Job) -> None:
    """Call all stages of a job finished."""
    for stage in STAGE_NAMES:
        job.finish(stage, job.keys[stage], 1.0, 2.0, 1, {}, [])
