# SPDX-License-Identifier: GPL-3.0-or-later
"""Speed of this machine compared with the machine that the cost estimates were fitted on (:mod:`mgf_engine.costs`).

Each finished job is compared with its estimate; the median ratio of the last jobs is kept in the user's cache folder.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mgf_engine.costs import COSTS, amount, seconds_of
from mgf_engine.files.atomic import write_json
from mgf_engine.system.machine import user_cache

_FILE = "speed.json"
_JOBS = 5  # number of recent jobs whose median ratio is used


@dataclass(frozen=True)
class StageTime:
    """Wall time of a stage, and its CPU time in all threads and worker processes; seconds."""

    seconds: float
    cpu_seconds: float


def known_speed() -> float:
    """Return the time of this machine divided by that of the reference machine; 1 before the first finished job."""
    ratios = _known_ratios()
    return float(np.median(ratios)) if ratios else 1.0


def record_speed(quantities: dict[str, float], times: dict[str, StageTime]) -> float | None:
    """Record the times of a finished job, and return the speed of this machine; None if they are implausible.

    CPU time does not depend on the load by other programs; wall time does not depend on hyper-threading, which makes
    CPU time longer than the work. The smaller of the two ratios is the better measure.

    Args:
        quantities: of the job, as :func:`mgf_engine.jobs.estimate.quantities` returns them.
        times: of each stage, by its name.
    """
    expected_cpu = sum(amount(COSTS["stages"][stage]["cpu"], quantities) for stage in times)
    expected = sum(seconds_of(stage, quantities) for stage in times)
    if not expected:
        return None
    cpu_ratio = sum(t.cpu_seconds for t in times.values()) / expected_cpu
    ratio = min(cpu_ratio, sum(t.seconds for t in times.values()) / expected)
    if not _plausible(ratio):
        return None
    ratios = [*_known_ratios(), round(ratio, 4)][-_JOBS:]
    try:
        write_json(_speed_file(), {"ratios": ratios})
    except OSError:
        return None  # the estimate stays as it was; not worth a warning
    return float(np.median(ratios))


def _known_ratios() -> list[float]:
    """Return the recorded ratios of the last jobs on this machine, oldest first."""
    try:
        found = [float(ratio) for ratio in json.loads(_speed_file().read_text(encoding="utf-8"))["ratios"]]
    except (OSError, ValueError, KeyError, TypeError):
        return []
    return [ratio for ratio in found if _plausible(ratio)][-_JOBS:]


def _plausible(ratio: float) -> bool:
    low, high = COSTS["speed"]
    return bool(low <= ratio <= high)


def _speed_file() -> Path:
    return user_cache() / _FILE
