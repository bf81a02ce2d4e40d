# SPDX-License-Identifier: GPL-3.0-or-later
"""Recycles the large scratch arrays of the CPU kernels.

Fresh memory costs more than using it: the system hands out zeroed pages one fault at a time. Arrays live in a
:class:`Frame`; when the frame is dropped they go back to the pool, and the next frame takes them again.
"""

from __future__ import annotations

import math
import threading
import weakref

import torch
from torch import Tensor

_POOL_LIMIT = 24  # arrays kept for later
_free: list[Tensor] = []
_lock = threading.Lock()


class Frame:
    """Arrays that belong to one rendering, from its forward to the end of its backward pass."""

    def __init__(self) -> None:
        self._taken: list[Tensor] = []

    def array(self, dtype: torch.dtype, *shape: int) -> Tensor:
        """An uninitialised array; do not use it after the frame is gone."""
        size = math.prod(shape) * dtype.itemsize
        block = _take(max(size, 64))
        self._taken.append(block)
        return block[:size].view(dtype).view(shape)

    def __del__(self) -> None:
        _give_back(self._taken)


def lasting_array(dtype: torch.dtype, *shape: int) -> Tensor:
    """An uninitialised array that goes back to the pool when the last tensor that shares its memory is gone."""
    size = math.prod(shape) * dtype.itemsize
    block = _take(max(size, 64))
    owner = block.numpy()[:size]  # torch holds on to this very object
    weakref.finalize(owner, _give_back, [block]).atexit = False
    return torch.from_numpy(owner).view(dtype).view(shape)


def _give_back(blocks: list[Tensor]) -> None:
    with _lock:
        _free.extend(blocks)
        _free.sort(key=len)
        del _free[:-_POOL_LIMIT]


def _take(size: int) -> Tensor:
    """The smallest free block that is large enough but not wastefully so, or a new one with room to grow."""
    with _lock:
        for i, block in enumerate(_free):
            if size <= len(block) <= 4 * size + 65536:
                return _free.pop(i)
    return torch.empty(-(-int(size * 1.25) // 64) * 64, dtype=torch.uint8)
