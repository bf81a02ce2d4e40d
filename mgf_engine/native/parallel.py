# SPDX-License-Identifier: GPL-3.0-or-later
"""Work on many photos or blocks of points at a time, one on each thread."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import cv2

from mgf_engine.memory import at_once
from mgf_engine.native.library import map_on_kernel_threads

S = TypeVar("S")
T = TypeVar("T")


def parallel_map(
    work: Callable[[S], T], items: Iterable[S], threads: int | None = None, bytes_each: float = 0.0
) -> Iterator[T]:
    """Yield ``work(item)`` of each item, in the order of the items, whichever is done first.

    What has not begun is dropped when the caller stops early, as on a cancelled job.

    Args:
        work: may run on any thread.
        items: made by the thread that asks.
        threads: how many items are worked on at a time, for work in NumPy and OpenCV, which release the interpreter.
            None: on the kernels' own threads, a few items ahead of what is taken; kernels that ``work`` calls run on
            one thread each, which with many items costs less than sharing every one.
        bytes_each: what one takes while it is worked on, where that is much: no more at a time than memory is left for.
    """
    most = at_once(bytes_each)
    if threads is None:
        yield from map_on_kernel_threads(work, items, most)
        return
    pool = ThreadPoolExecutor(max(1, min(threads, most)))
    try:
        yield from pool.map(work, list(items))
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def plain_opencv() -> Iterator[None]:
    """OpenCV without threads of its own: beside others that work they only wait, and waiting costs as much as work."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
