# SPDX-License-Identifier: GPL-3.0-or-later
"""Loads the best kernel library for this processor and runs its work loops on several threads.

The kernels are plain C behind ctypes, which releases Python's global lock during a call: threads are Python
threads that all call the same work loop and share one counter of pieces done (``csrc/common/export.h``).

Environment: ``MGF_KERNEL_VARIANT`` names the variant to load instead of the best one (``x86-64-v3``).
"""

from __future__ import annotations

import ctypes
import os
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from mgf_engine.errors import BadInstallation
from mgf_engine.native.build import TARGETS, VARIANTS, host_target, library_path
from mgf_engine.system.machine import cores, release_memory

#: ``alone``: work loops that this thread starts run on it only, because others of its kind keep the cores busy.
_here = threading.local()
_HINT = "run 'python -m mgf_engine.native.build' to compile the kernels"

#: Items per piece of the work loops whose first argument counts items (``PIECE`` in their source); of others that
#: argument is the number of pieces, or the caller says how many there are.
ITEMS_PER_PIECE = {
    "mgf_adam": 2048, "mgf_project": 256, "mgf_project_backward": 256, "mgf_locate_points": 4096,
    "mgf_integrate_depths": 2048, "mgf_match_photos": 64, "mgf_project_vertices": 8192, "mgf_open_edges": 4096,
    "mgf_patch_match": 64, "mgf_vertex_fans": 4096, "mgf_smooth_vertices": 4096, "mgf_smooth_points": 512,
    "mgf_vertex_normals": 4096, "mgf_tetra_neighbours": 4096,
}  # fmt: skip

S = TypeVar("S")
T = TypeVar("T")
_threads = 0
#: Of a counter of pieces: work loops end at their next one.
_NO_PIECES_LEFT = 2**30
_pool: ThreadPoolExecutor | None = None
_side: ThreadPoolExecutor | None = None  # for map_on_kernel_threads
_current: ctypes.CDLL | None = None
_current_variant = ""


class NoKernels(BadInstallation, RuntimeError):
    """The kernels cannot be used here as they are; the sentence says what to do."""


class _Kernels(ctypes.CDLL):
    """A kernel library that says what to do where it lacks a kernel: it was built before this engine."""

    def __getattr__(self, name: str) -> Any:
        try:
            return super().__getattr__(name)
        except AttributeError as error:
            if not name.startswith("mgf_"):
                raise
            raise NoKernels(
                f"The kernel library {Path(self._name).name} is older than this engine and lacks '{name}'; {_HINT}."
            ) from error


def runnable_variants() -> list[str]:
    """Return the variants of this processor's family that it can run, best last, whether built or not."""
    family = TARGETS[host_target()].family
    names = list(VARIANTS[family])
    if family != "x86_64":
        return names
    level = _open(names[0]).mgf_cpu_level()
    return [name for name, needed in zip(names, (1, 3, 4), strict=True) if level >= needed]


def variant() -> str:
    """Return the name of the loaded variant (loads one if none is)."""
    library()
    return _current_variant


def use_variant(name: str) -> None:
    """Load the named variant and use it from now on; "" goes back to the environment's or the best one.

    Raises:
        NoKernels: unknown name, a processor that cannot run it, or a library that is not built.
    """
    global _current, _current_variant
    runnable = runnable_variants()
    name = name or os.environ.get("MGF_KERNEL_VARIANT", "") or runnable[-1]
    if name not in runnable:
        raise NoKernels(f"Kernel variant '{name}' does not run on this processor; choose {', '.join(runnable)}.")
    _current, _current_variant = _open(name), name


def library() -> ctypes.CDLL:
    """Return the loaded library; loads the best variant on first use.

    Raises:
        NoKernels: the library is not built; the message says how to build it.
    """
    if _current is None:
        use_variant("")
    assert _current is not None
    return _current


@cache
def _open(name: str) -> ctypes.CDLL:
    path = library_path(host_target(), name)
    if not path.is_file():
        raise NoKernels(f"The kernel library {path.name} is missing; {_HINT}.")
    try:
        loaded = _Kernels(str(path))
        loaded.mgf_cpu_level.restype = ctypes.c_int64
    except (OSError, AttributeError) as error:
        raise NoKernels(f"The kernel library {path} cannot be loaded ({error}); {_HINT}.") from error
    return loaded


def set_threads(count: int) -> None:
    """Set the number of threads that work loops run on; 0 takes every core this process may use."""
    global _threads, _pool, _side
    count = count or cores()
    if count == _threads:
        return
    for pool in (_pool, _side):
        if pool is not None:
            pool.shutdown()
    _threads, _pool, _side = count, None, None
    if count > 1:
        _pool = ThreadPoolExecutor(count - 1, "mgf-kernel")
        _side = ThreadPoolExecutor(count, "mgf-side", initializer=_stay_alone)


def threads() -> int:
    """Return the number of threads that work loops run on."""
    if not _threads:
        set_threads(0)
    return _threads


def call(name: str, *arguments: Any) -> int:
    """Call one kernel on this thread; returns its result (kernels return nothing or an int64).

    Args:
        name: of the C function.
        arguments: contiguous numpy arrays or torch tensors, ints, floats or None (a null pointer).
    """
    function = getattr(library(), name)
    function.restype = ctypes.c_int64
    return function(*map(_to_c, arguments))


def parallel(name: str, *arguments: Any, pieces: int | None = None) -> None:
    """Run a work loop on :func:`threads` threads with a shared counter of pieces, and wait for all of them.

    Waking a thread takes longer than a small piece of work, so no more threads are woken than there are pieces.

    Args:
        name: of a C function whose first parameter is ``int32_t *next``.
        arguments: its further arguments, see :func:`call`.
        pieces: at most as many pieces of work; None: as the first argument tells (:data:`ITEMS_PER_PIECE`).
    """
    function = getattr(library(), name)
    function.restype = None
    if pieces is None:
        pieces = -(-arguments[0] // ITEMS_PER_PIECE.get(name, 1))
    counter = ctypes.c_int32(0)
    converted = [ctypes.byref(counter), *map(_to_c, arguments)]
    workers: list[Future[None]] = []
    try:
        if own_threads() > 1 and _pool is not None:
            for _ in range(min(_threads, pieces) - 1):
                workers.append(_pool.submit(function, *converted))
        function(*converted)
        for worker in workers:
            worker.result()
    except BaseException:  # after Ctrl-C others may still be at work in arrays that are about to go
        counter.value = _NO_PIECES_LEFT
        wait(workers)
        raise


def by_reference(struct: ctypes.Structure) -> ctypes.c_void_p:
    """Return the address of a struct for a kernel; struct and the arrays that it points to must outlive the call."""
    return ctypes.c_void_p(ctypes.addressof(struct))


def own_threads() -> int:
    """Return the number of threads that a work loop started on this thread gets."""
    return 1 if getattr(_here, "alone", False) else threads()


def map_on_kernel_threads(work: Callable[[S], T], items: Iterable[S], most: int = sys.maxsize) -> Iterator[T]:
    """Yield ``work`` of each item, in order, made on :func:`threads` threads, a few ahead of what is taken.

    Work loops inside ``work`` run on one thread each: with many items that costs less than sharing every one. The items
    themselves are made by the thread that asks.

    Args:
        most: that may be there at a time, begun or waiting to be taken.
    """
    if own_threads() == 1 or most == 1:
        yield from map(work, items)
        return
    assert _side is not None
    ahead: deque[Future[T]] = deque()
    try:
        for item in items:
            ahead.append(_side.submit(work, item))
            if len(ahead) > min(threads(), most - 1):
                yield ahead.popleft().result()
        while ahead:
            yield ahead.popleft().result()
    finally:
        for future in ahead:
            future.cancel()
        wait(ahead)
        release_memory()


def _stay_alone() -> None:
    _here.alone = True


def _to_c(value: Any) -> Any:
    """Convert the argument as ctypes wants it; see the convention in ``csrc/common/export.h``."""
    if value is None:
        return ctypes.c_void_p(None)
    if isinstance(value, np.ndarray):
        assert value.flags.c_contiguous
        return ctypes.c_void_p(value.ctypes.data)
    if isinstance(value, int):
        return ctypes.c_int64(value)
    if isinstance(value, float):
        return ctypes.c_float(value)
    if hasattr(value, "data_ptr"):  # a tensor; torch takes a second to load, which arrays alone do not need
        assert value.is_contiguous() and value.device.type == "cpu"
        return ctypes.c_void_p(value.data_ptr())
    return value
