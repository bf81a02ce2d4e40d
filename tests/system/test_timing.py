# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

import time

import pytest

from mgf_engine.system.machine import cpu_seconds
from mgf_engine.system.timing import PartTimes


def test_time_adds_up_per_part_also_when_it_fails() -> None:
    times = PartTimes()
    for _ in range(2):
        with times.part("waiting"):
            time.sleep(0.05)
    with pytest.raises(ValueError, match="no"), times.part("working"):
        ends = cpu_seconds() + 0.05  # the clock that counts the parts, coarser than process_time's
        while cpu_seconds() < ends:
            pass
        raise ValueError("no")
    figures = times.figures()
    assert list(figures["seconds_per_part"]) == ["waiting", "working"] == list(figures["cpu_seconds_per_part"])
    assert figures["seconds_per_part"]["waiting"] >= 0.1 > figures["cpu_seconds_per_part"]["waiting"]
    assert figures["cpu_seconds_per_part"]["working"] >= 0.05
