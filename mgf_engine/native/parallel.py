# SPDX-License-Identifier: GPL-3.0-or-later
"""One photo (or block of points) per thread: they are many and alike, and NumPy and OpenCV release the interpreter."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import cv2

T = TypeVar("T")


def in_order(task: Callable[[int], T], indices: Iterable[int], threads: int) -> Iterator[tuple[int, T]]:
    """(index, result of the task) in the order of the indices, whichever is done first.

    What has not begun is dropped when the caller stops early, as on a cancelled job.
    """
    indices = list(indices)
    pool = ThreadPoolExecutor(max(1, threads))
    try:
        yield from zip(indices, pool.map(task, indices), strict=True)
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
