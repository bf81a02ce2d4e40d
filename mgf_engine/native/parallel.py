# SPDX-License-Identifier: GPL-3.0-or-later
"""Map a function over many photos or chunks of points on several threads."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

import cv2

from mgf_engine.native.library import map_on_kernel_threads
from mgf_engine.native.library import threads as kernel_threads
from mgf_engine.system.memory import at_once

S = TypeVar("S")
T = TypeVar("T")


def parallel_map(
    work: Callable[[S], T], items: Iterable[S], threads: int | None = None, bytes_each: float = 0.0
) -> Iterator[T]:
    """Yield ``work(item)`` of each item, in the order of the items, whichever is done first.

    There is one pool, of as many threads as the kernels have, a few items ahead of what is taken. Kernels and maps that
    ``work`` calls run on its own thread, which with many items costs less than sharing every one. What has not begun is
    dropped when the caller stops early, as on a cancelled job.

    Args:
        work: may run on any thread.
        items: made by the thread that asks.
        threads: maximum number of items at a time; None for the number of kernel threads, which is never exceeded.
        bytes_each: what one takes while it is worked on, where that is much: no more at a time than memory is left for.
    """
    most = at_once(bytes_each)
    if threads is not None and threads < kernel_threads():
        most = min(most, max(1, threads))
    yield from map_on_kernel_threads(work, items, most)


@contextmanager
def plain_opencv() -> Iterator[None]:
    """Take OpenCV's own threads away: beside others that work they only wait, and waiting costs as much as work."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
