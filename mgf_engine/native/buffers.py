# SPDX-License-Identifier: GPL-3.0-or-later
"""Recycles the large scratch arrays of the CPU kernels.

Fresh memory costs more than using it: the system hands out zeroed pages one fault at a time. Arrays live in a
:class:`RenderBuffers`; when it is dropped they go back to the pool, and the next rendering takes them again.
"""

from __future__ import annotations

import math
import threading
import weakref
from queue import SimpleQueue

import torch
from torch import Tensor

_POOL_LIMIT = 24  # arrays kept for later
_free: list[Tensor] = []
_lock = threading.Lock()  # of _free
#: Blocks on their way back. Python may drop buffers at any moment, inside `_take`, too, where this thread holds
#: the lock already; the queue's put is made for that.
_returned: SimpleQueue[Tensor] = SimpleQueue()


class RenderBuffers:
    """Arrays that belong to one rendering, from its forward to the end of its backward pass."""

    def __init__(self) -> None:
        self._taken: list[Tensor] = []

    def array(self, dtype: torch.dtype, *shape: int) -> Tensor:
        """Return an uninitialised array; do not use it after the buffers are gone."""
        size = math.prod(shape) * dtype.itemsize
        block = _take(max(size, 64))
        self._taken.append(block)
        return block[:size].view(dtype).view(shape)

    def __del__(self) -> None:
        _give_back(self._taken)


def lasting_array(dtype: torch.dtype, *shape: int) -> Tensor:
    """Return an uninitialised array that goes back to the pool when the last tensor that shares its memory is gone."""
    size = math.prod(shape) * dtype.itemsize
    block = _take(max(size, 64))
    owner = block.numpy()[:size]  # torch holds on to this very object
    weakref.finalize(owner, _give_back, [block]).atexit = False
    return torch.from_numpy(owner).view(dtype).view(shape)


def release_buffers() -> None:
    """Let go of all arrays that are kept for later: what comes next asks for others."""
    with _lock:
        _sort_in()
        _free.clear()


def _give_back(blocks: list[Tensor]) -> None:
    """Return a block without waiting: may run while this thread or another is inside `_take`, which then sorts it
    in."""
    for block in blocks:
        _returned.put(block)
    if _lock.acquire(blocking=False):
        try:
            _sort_in()
        finally:
            _lock.release()


def _sort_in() -> None:
    """Take what was returned into the pool and drop the smallest arrays of too many; under the lock."""
    while not _returned.empty():
        _free.append(_returned.get())
    _free.sort(key=len)
    del _free[:-_POOL_LIMIT]


def _take(size: int) -> Tensor:
    """Return the smallest free block that is large enough but not wastefully so, or a new one with room to grow."""
    with _lock:
        _sort_in()
        for i, block in enumerate(_free):
            if size <= len(block) <= 4 * size + 65536:
                return _free.pop(i)
    return torch.empty(-(-int(size * 1.25) // 64) * 64, dtype=torch.uint8)
