# SPDX-License-Identifier: GPL-3.0-or-later
"""Installations of the engine without packages, for tests."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from mgf_blender.engine import environment, install, swap
from mgf_blender.engine.task import Step, Task


def plan(tmp_path: Path, **more: object) -> install.InstallPlan:
    values = {
        "target": tmp_path / "environment", "python": Path(sys.executable), "wheel": tmp_path / "mgf_engine-1.whl",
        "constraints": tmp_path / "constraints.txt", "wheel_folder": None, "torch": "cpu",
    }  # fmt: skip
    return install.InstallPlan(**{**values, **more})


def shortened(tmp_path: Path, ending: str) -> Task:
    """An installation whose packages are left out: the environment, and a check that ends in some way."""
    task = install.make_task(plan(tmp_path), tmp_path / "log.txt")
    made = Step(task.steps[0].title, [*task.steps[0].command, "--without-pip"])
    task.steps = [made, Step("Checking the engine", [task.steps[-1].command[0], "-c", ending])]
    return task


def prefix_of(tmp_path: Path) -> str:
    python = environment.python_of(tmp_path / "environment")
    done = subprocess.run([python, "-c", "import sys; print(sys.prefix)"], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def folders(tmp_path: Path) -> list[str]:
    swap.wait_for_removal()
    return sorted(p.name for p in tmp_path.iterdir() if p.is_dir())
