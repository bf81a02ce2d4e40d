# SPDX-License-Identifier: GPL-3.0-or-later
"""What does not fit into memory lies in a file of the job folder, and reads the same."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import psutil
import pytest

from mgf_engine.files.spill import Spill
from mgf_engine.system import memory

MB = 1_000_000


@pytest.fixture(autouse=True)
def _no_budget():
    yield
    memory.allow(0.0)


def arrays(count: int, size: int) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [rng.random((size, 4), np.float32) for _ in range(count)]


def test_the_first_stay_in_memory_and_the_others_read_the_same(tmp_path: Path) -> None:
    memory.allow(10 * MB, tmp_path)  # 0.15 of it: 1.5 MB
    given = [*arrays(5, 40_000), np.zeros((0, 4), np.float32)]  # 0.64 MB each
    spill = Spill()
    kept = [spill.keep(array) for array in given]
    assert [a is b for a, b in zip(given, kept, strict=True)] == [True, True, False, False, False, True]
    for _ in range(2):
        for before, after in zip(given, kept, strict=True):
            np.testing.assert_array_equal(before, after)
            assert after.dtype == before.dtype
        spill.release()
    with pytest.raises(ValueError, match="read-only"):
        kept[2][0] = 1


def test_nothing_is_written_outside_of_a_job() -> None:
    memory.allow(MB)
    spill = Spill()
    given = arrays(3, 40_000)
    assert all(spill.keep(array) is array for array in given)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux gives mapped memory back at once")
def test_released_arrays_take_no_memory(tmp_path: Path) -> None:
    memory.allow(10 * MB, tmp_path)
    spill = Spill()
    kept = [spill.keep(array) for array in arrays(20, 500_000)]  # 160 MB
    assert not list(tmp_path.iterdir())  # the file has no name: nothing is left behind however the job ends
    before = psutil.Process().memory_info().rss
    total = sum(float(array.sum()) for array in kept)
    read = psutil.Process().memory_info().rss
    spill.release()
    assert read - before > 100 * MB and psutil.Process().memory_info().rss - before < 20 * MB
    assert total == sum(float(array.sum()) for array in kept)
