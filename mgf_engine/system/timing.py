# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure the time of the parts of a stage."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager

from mgf_engine.system.machine import cpu_seconds


class PartTimes:
    """Seconds that pass in the parts of a stage, and seconds of processor time that all threads, and
    processes that end there, spend."""

    def __init__(self) -> None:
        self._seconds: dict[str, float] = defaultdict(float)
        self._cpu: dict[str, float] = defaultdict(float)

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Count what is done inside for the part ``name``."""
        started, cpu = time.perf_counter(), cpu_seconds()
        try:
            yield
        finally:
            self._seconds[name] += time.perf_counter() - started
            self._cpu[name] += cpu_seconds() - cpu

    def figures(self) -> dict[str, dict[str, float]]:
        """Return ``seconds_per_part`` and ``cpu_seconds_per_part``, part -> seconds in the order in which parts
        began."""
        parts = {"seconds_per_part": self._seconds, "cpu_seconds_per_part": self._cpu}
        return {key: {name: round(value, 2) for name, value in values.items()} for key, values in parts.items()}
