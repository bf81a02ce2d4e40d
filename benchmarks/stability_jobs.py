# SPDX-License-Identifier: GPL-3.0-or-later
"""Small jobs that are disturbed: how they are run to their end, and whether they give what an undisturbed one gives."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

from benchmarks.synthetic.house import House

OPTIONS = ["--iterations", "120", "--max-gaussians", "3000", "--densify-every", "40", "--level-steps", "3",
           "--resolution", "160", "--checkpoint-seconds", "1", "--threads", "2"]  # fmt: skip


ENVIRONMENT = {**os.environ, "OMP_WAIT_POLICY": "PASSIVE"}


def command(*args: object) -> list[str]:
    """The engine as a process of its own."""
    return [sys.executable, "-m", "mgf_engine", *map(str, args), "--progress", "json"]


def start_args(house: House, job: Path, *more: object) -> list[object]:
    return ["reconstruct", house.folder, "--prompts", house.prompts, "--out", job, *OPTIONS, "--resume", *more]


def finish(house: House, job: Path, *more: object, **how: object) -> tuple[int, dict, str]:
    """Run the job to its end: exit code, last message, what was printed to standard error."""
    run = subprocess.run(command(*start_args(house, job, *more)), capture_output=True, text=True, env=ENVIRONMENT,
                         timeout=1800, **how)  # type: ignore[call-overload]  # fmt: skip
    lines = [line for line in run.stdout.splitlines() if line.startswith("{")]
    return run.returncode, json.loads(lines[-1]) if lines else {}, run.stderr


def result(job: Path) -> dict[str, str]:
    """Hashes of what a finished job offers."""
    names = ["mesh.ply", "field.ply", *(str(p.relative_to(job)) for p in sorted((job / "masks/labels").glob("*.png")))]
    return {name: hashlib.sha256((job / name).read_bytes()).hexdigest() for name in names}


def check_whole(job: Path, expected: dict[str, str]) -> None:
    """A finished job equals the undisturbed one and holds nothing half-written."""
    found = result(job)
    assert found == expected, [name for name in expected if found.get(name) != expected[name]]
    left = [str(p) for p in job.rglob("*") if p.name.startswith(".part-") or p.suffix == ".part"]
    assert not left, left
