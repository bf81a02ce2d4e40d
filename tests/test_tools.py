# SPDX-License-Identifier: GPL-3.0-or-later
"""The scripts under ``tools`` agree with the packages they speak of."""

from __future__ import annotations

import importlib.metadata
import os
import runpy
import subprocess
import sys
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from mgf_engine.native.build import TARGETS


def test_the_extension_carries_the_engine_for_every_target() -> None:
    script = runpy.run_path(str(Path(__file__).parents[1] / "tools" / "build_extension.py"), run_name="tools")
    assert set(script["ALL_TARGETS"]) == set(TARGETS)


def test_every_package_of_an_installation_is_pinned() -> None:
    lines = (Path(__file__).parents[1] / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pinned = {canonicalize_name(line.split("==")[0]) for line in lines if "==" in line}
    found, waiting = set(), ["mgf-engine"]
    while waiting:
        name = canonicalize_name(waiting.pop())
        if name in found or name.startswith(("nvidia-", "triton")):  # torch pins those itself
            continue
        found.add(name)
        needs = [Requirement(text) for text in importlib.metadata.requires(name) or []]
        waiting += [need.name for need in needs if need.marker is None or need.marker.evaluate({"extra": ""})]
    assert len(found) > 25 and found - {"mgf-engine"} <= pinned


def test_the_kernels_elsewhere_are_tested_by_tests_that_there_are() -> None:
    root = Path(__file__).parents[1]
    script = runpy.run_path(str(root / "tools" / "foreign_kernels.py"), run_name="tools")
    assert [name for name in script["TESTS"] if not (root / "tests" / name).is_file()] == []


def test_the_demo_finds_the_benchmarks_which_are_not_installed(tmp_path: Path) -> None:
    script = Path(__file__).parents[1] / "tools" / "demo.py"
    nowhere = ["--blender-python", str(tmp_path / "python"), "--out", str(tmp_path / "demo")]
    bare = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    run = subprocess.run(
        [sys.executable, str(script), *nowhere], cwd=tmp_path, env=bare, capture_output=True, text=True, check=False
    )
    assert (run.returncode, run.stderr.splitlines()) == (
        2,
        [f"Error: There is no Python '{tmp_path / 'python'}'; give one that has bpy."],
    )
