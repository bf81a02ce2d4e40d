# SPDX-License-Identifier: GPL-3.0-or-later
"""Running jobs in tests: drain them as the timer does, and read what the engine was given."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path

from mgf_blender.common import runner


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
