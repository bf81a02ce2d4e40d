# SPDX-License-Identifier: GPL-3.0-or-later
"""Interface of both builds of the CUDA sources: how a kernel is named, gets its arguments and is launched."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor

THREADS = 256  # per block, of every kernel: csrc/cuda/block.cuh

Grid = int | tuple[int, int]


@dataclass(frozen=True)
class At:
    """A place inside a tensor, which need not be contiguous: ``offset`` elements after its first one."""

    tensor: Tensor
    offset: int


class Launcher(Protocol):
    """Starts kernels of ``kernels/cuda/*.cu`` on tensors of one device, in order, without waiting for them."""

    @property
    def device(self) -> torch.device:
        """Where the tensors lie."""

    def launch(self, name: str, grid: Grid, *arguments: Any) -> None:
        """Start ``grid`` blocks of a kernel; a grid of nothing starts nothing. Arguments: see :func:`pack`."""

    def read_later(self, tensor: Tensor) -> Callable[[], list[int]]:
        """Begin to copy a small tensor to the host; to ask the result for the numbers is to wait for them."""


def blocks(items: int, each: int = THREADS) -> int:
    """Return the number of blocks of ``each`` threads that hold ``items`` threads."""
    return -(-items // each)


def pack(arguments: Sequence[Any], device: torch.device) -> tuple[Any, list[Any]]:
    """Return the arguments as ``cuLaunchKernel`` takes them, an array of addresses; and what must outlive the call.

    Tensors, :class:`At` and None become pointers, whole numbers int32, real numbers float32, bytes and tuples structs
    by value (a tuple's members follow the same rules).
    """
    values = [_to_c(a, device) for a in arguments]
    return (ctypes.c_void_p * len(values))(*map(ctypes.addressof, values)), values


def _to_c(value: Any, device: torch.device) -> Any:
    if isinstance(value, tuple):
        return _buffer(_struct(value, device))
    if isinstance(value, bytes):
        return _buffer(value)
    if isinstance(value, int):
        return ctypes.c_int32(value)
    if isinstance(value, float):
        return ctypes.c_float(value)
    return ctypes.c_void_p(_address(value, device))


def _buffer(data: bytes) -> Any:
    return ctypes.create_string_buffer(data, len(data))


def _struct(members: tuple[Any, ...], device: torch.device) -> bytes:
    codes = "".join("i" if isinstance(m, int) else "f" if isinstance(m, float) else "P" for m in members)
    values = [m if isinstance(m, int | float) else _address(m, device) for m in members]
    return struct.pack("@" + codes + ("0P" if "P" in codes else ""), *values)


def _address(value: Tensor | At | None, device: torch.device) -> int:
    if value is None:
        return 0
    if isinstance(value, At):
        _address(value.tensor[:0].contiguous(), device)
        return value.tensor.data_ptr() + value.offset * value.tensor.element_size()
    tensor = value
    if tensor.device != device or not tensor.is_contiguous():  # of two GPUs, each has its own memory
        raise ValueError(f"a kernel on {device} was given a tensor on {tensor.device} that it cannot read")
    return tensor.data_ptr()
