# SPDX-License-Identifier: GPL-3.0-or-later
import threading
import time

import cv2
import pytest

from mgf_engine.native import library
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


def test_an_interrupted_kernel_returns_when_all_of_its_threads_have_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C ends the caller's part; arrays that another thread is still writing to must not go with it."""
    seen: list[str] = []
    begun = threading.Event()

    class Kernels:
        @staticmethod
        def kernel(counter: object) -> None:
            if threading.current_thread() is threading.main_thread():
                assert begun.wait(20)
                raise KeyboardInterrupt
            begun.set()
            end = time.monotonic() + 20
            while counter._obj.value < 1000 and time.monotonic() < end:  # type: ignore[attr-defined]
                time.sleep(0.01)
            seen.append("ended" if time.monotonic() < end else "not told to end")

    monkeypatch.setattr(library, "library", lambda: Kernels)
    before = library.threads()
    library.set_threads(2)
    try:
        with pytest.raises(KeyboardInterrupt):
            library.parallel("kernel", pieces=2)
        assert seen == ["ended"]
    finally:
        library.set_threads(before)


def test_opencv_gets_its_threads_back() -> None:
    before = cv2.getNumThreads()
    with pytest.raises(ValueError, match="stop"), plain_opencv():
        assert cv2.getNumThreads() == 1
        raise ValueError("stop")
    assert cv2.getNumThreads() == before


def test_maps_inside_a_map_run_on_its_threads() -> None:
    """One pool: a map in a map would wait for itself if it asked for threads of its own."""

    def outer(index: int) -> tuple[str, set[str]]:
        inner = set(parallel_map(lambda k: threading.current_thread().name, range(4), 4))
        return threading.current_thread().name, inner

    for name, inner in parallel_map(outer, range(6), 4):
        assert inner == {name}


def test_fewer_threads_work_on_fewer_items_at_a_time() -> None:
    now, most = 0, 0
    lock = threading.Lock()

    def task(index: int) -> None:
        nonlocal now, most
        with lock:
            now += 1
            most = max(most, now)
        time.sleep(0.01)
        with lock:
            now -= 1

    before = library.threads()
    library.set_threads(4)
    try:
        list(parallel_map(task, range(12), 2))
    finally:
        library.set_threads(before)
    assert most == 2
