# SPDX-License-Identifier: GPL-3.0-or-later
"""Running jobs in tests: the engine's double, draining as the timer does, and what the engine was given."""

from __future__ import annotations

import json
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path

from mgf_blender.common import runner

HERE = Path(__file__).parent


def write_engine(home: Path) -> Path:
    """Write a program that runs as a Python whose ``-m mgf_engine`` is the double, see :mod:`fake_engine`; its path."""
    package = home / "mgf_engine"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("")
    shutil.copyfile(HERE / "fake_engine.py", package / "__main__.py")
    shutil.copyfile(HERE.parents[1] / "mgf_blender" / "options.json", package / "options.json")
    python = home / "python"
    python.write_text(f'#!/bin/sh\nPYTHONPATH="{home}" PYTHONSAFEPATH=1 exec "{sys.executable}" "$@"\n')
    python.chmod(0o755)
    return python


def pump_until(
    until: Callable[[], object], pump: Callable[[], object] = runner.pump, seconds: float = 20.0, pause: float = 0.01
) -> int:
    """Pump until a condition holds, and fail after some seconds; returns how often it was pumped."""
    end, times = time.monotonic() + seconds, 0
    while not until() and time.monotonic() < end:
        pump()
        times += 1
        time.sleep(pause)
    assert until()
    return times


def arguments(job: str | Path) -> list[str]:
    """The command line that the fake engine was started with in a job folder."""
    return json.loads(Path(job, "arguments.json").read_text())
