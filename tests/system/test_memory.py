# SPDX-License-Identifier: GPL-3.0-or-later
"""The budget of a job and the measure of what it takes."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from mgf_engine.native.library import set_threads
from mgf_engine.native.parallel import parallel_map
from mgf_engine.system import memory
from mgf_engine.system.machine import total_memory
from mgf_engine.system.memory import (
    GB,
    MemoryMonitor,
    allow,
    allowed,
    at_once,
    budget_of,
    fits_beside,
    free_memory,
    share,
)
from mgf_engine.system.subprocesses import worker


@pytest.fixture(autouse=True)
def _no_budget_left_behind():
    yield
    allow(0.0)


def test_a_job_may_use_what_the_user_says_or_three_quarters_of_what_is_free() -> None:
    assert budget_of(2.5) == 2.5 * GB
    assert budget_of(0.0, free=8_000_000_000) == 6 * GB
    assert 0 < free_memory() < total_memory()
    allow(4 * GB)
    assert allowed() == 4 * GB and share(0.25, 10**12) == GB and share(0.25, 1000) == 1000


def test_no_more_is_worked_on_at_a_time_than_memory_is_left_for() -> None:
    """Counted, for both kinds of threads; what comes out and its order stay the same."""
    lock, now, most = threading.Lock(), 0, 0

    def work(item: int) -> int:
        nonlocal now, most
        with lock:
            now += 1
            most = max(most, now)
        time.sleep(0.01)
        with lock:
            now -= 1
        return item * item

    set_threads(6)
    try:
        for threads in (6, None):
            for fitting in (100, 3, 1, 0):
                most = 0
                allow(psutil.Process().memory_info().rss + GB)
                each = 0.5 * GB / (fitting + 0.2)
                assert list(parallel_map(work, range(24), threads, each)) == [n * n for n in range(24)]
                assert most <= max(1, fitting) and (most > 1) == (fitting > 1)
    finally:
        set_threads(0)
    assert at_once(0) > 10**9


def test_work_beside_other_work_takes_half_of_what_is_left_and_never_much() -> None:
    allow(psutil.Process().memory_info().rss + 2 * memory.BESIDE)
    assert fits_beside(0.8 * memory.BESIDE) and not fits_beside(1.3 * memory.BESIDE)
    allow(psutil.Process().memory_info().rss + 100 * GB)
    assert fits_beside(memory.BESIDE) and not fits_beside(1.01 * memory.BESIDE)


@pytest.mark.parametrize(("limit", "left"), [("3000", [3000 - (1200 - 200)]), ("max", [])])
def test_the_limit_of_a_container_counts(tmp_path: Path, limit: str, left: list[int]) -> None:
    group = tmp_path / "jobs" / "42"
    group.mkdir(parents=True)
    (group / "memory.max").write_text(limit + "\n")
    (group / "memory.current").write_text("1200\n")
    (group / "memory.stat").write_text("anon 900\ninactive_file 200\n")
    (tmp_path / "own").write_text("1:cpu:/x\n0::/jobs/42\n")
    assert memory._left_in_groups(tmp_path, tmp_path / "own") == left
    assert memory._left_in_groups(tmp_path, tmp_path / "none") == []


def test_the_watch_sees_a_short_peak_and_starts_anew() -> None:
    with MemoryMonitor() as before:
        pass
    with MemoryMonitor() as large:
        np.ones(200 << 20, np.uint8)
        time.sleep(0 if sys.platform.startswith("linux") else 1.2)
    with MemoryMonitor() as after:
        pass
    assert large.peak > before.peak + (150 << 20)
    assert after.peak < large.peak - (100 << 20) or not sys.platform.startswith("linux")


def test_the_watch_counts_the_workers() -> None:
    hold = "import sys; big = b'x' * (300 << 20); sys.stdout.write('.'); sys.stdout.flush(); sys.stdin.read()"
    pipe = subprocess.PIPE
    with MemoryMonitor() as alone:
        pass
    with MemoryMonitor() as together, worker([sys.executable, "-c", hold], stdin=pipe, stdout=pipe) as process:
        assert process.stdout and process.stdin
        process.stdout.read(1)
        time.sleep(3 * memory._SAMPLE_SECONDS)
        process.stdin.close()
    assert together.peak > alone.peak + (250 << 20)
