# SPDX-License-Identifier: GPL-3.0-or-later
import time

import cv2
import pytest

from mgf_engine.native.parallel import parallel_map, plain_opencv


@pytest.mark.parametrize("threads", [None, 0, 1, 3])
def test_results_come_in_order_whichever_is_done_first(threads: int | None) -> None:
    def slow_first(index: int) -> int:
        time.sleep(0.05 if index == 4 else 0.0)
        return 10 * index

    assert list(parallel_map(slow_first, [4, 2, 7], threads)) == [40, 20, 70]


def test_an_error_reaches_the_caller_and_drops_the_rest() -> None:
    begun = []

    def task(index: int) -> None:
        begun.append(index)
        if index == 0:
            raise ValueError("broken")
        time.sleep(0.02)

    with pytest.raises(ValueError, match="broken"):
        list(parallel_map(task, range(100), 2))
    assert len(begun) < 50


def test_a_caller_that_stops_early_drops_the_rest() -> None:
    begun = []

    def task(index: int) -> int:
        begun.append(index)
        time.sleep(0.02)
        return index

    for index in parallel_map(task, range(100), 2):
        if index == 1:
            break
    time.sleep(0.1)
    assert len(begun) < 50


def test_opencv_gets_its_threads_back() -> None:
    before = cv2.getNumThreads()
    with pytest.raises(ValueError, match="stop"), plain_opencv():
        assert cv2.getNumThreads() == 1
        raise ValueError("stop")
    assert cv2.getNumThreads() == before
