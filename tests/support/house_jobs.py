# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole jobs of the small painted house, and the score of their meshes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from benchmarks import stability_spread
from benchmarks.synthetic.house import House
from mgf_engine.stages import STAGE_NAMES
from support.jobs import finish, start

OPTIONS = ["--iterations", "150", "--max-gaussians", "5000", "--densify-every", "50", "--level-steps", "4"]


def reconstruct(house: House, job: Path, *more: object) -> list[dict]:
    run = start("reconstruct", house.folder, "--prompts", house.prompts, "--out", job, *OPTIONS, *more)
    messages = finish(run)
    assert run.returncode == 0, messages[-1]
    return messages


def f1(mesh_file: Path, house: House, threshold: float) -> float:
    """F1 between a mesh and the house, 0 to 1, from few samples."""
    return stability_spread.f1(mesh_file, house, threshold, 4000) / 100


def copy_until(finished: Path, job: Path, stage: str) -> None:
    """A copy of a finished job as it was before ``stage`` began."""
    shutil.copytree(finished, job)
    data = json.loads((job / "job.json").read_text())
    for name in STAGE_NAMES[STAGE_NAMES.index(stage) :]:
        data["stages"].pop(name, None)
        (job / f".started-{name}").unlink(missing_ok=True)
    (job / "job.json").write_text(json.dumps(data))
