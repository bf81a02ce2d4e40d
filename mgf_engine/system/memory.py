# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory of a job: free memory, the budget (``--memory``), and the peak of each stage.

The budget limits how many photos are processed at a time, never the result: the mesh is the same with any budget.
"""

from __future__ import annotations

import contextlib
import sys
import threading
from pathlib import Path
from types import TracebackType

import psutil

from mgf_engine.errors import BadInput
from mgf_engine.system.machine import peak_memory, release_memory
from mgf_engine.system.subprocesses import RUNNING

GB = 1e9
#: Share of the free memory at the start that a job may use by default.
DEFAULT_SHARE = 0.75
#: Bytes that work beside other work may take: the tetrahedra of 1.6 million points, of most jobs with 50 photos.
BESIDE = 0.4 * GB
_SAMPLE_SECONDS = 0.5
_CGROUPS = Path("/sys/fs/cgroup")
_allowed = 0.0
_scratch: Path | None = None
_strict = False


def free_memory() -> int:
    """Return the free memory in bytes, within the limits of the control group and of ``ulimit -v``."""
    left = [psutil.virtual_memory().available, *_left_in_groups()]
    with contextlib.suppress(ImportError, OSError, ValueError, AttributeError):
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        if limit != resource.RLIM_INFINITY:
            left.append(limit - psutil.Process().memory_info().vms)
    return max(0, min(left))


def _left_in_groups(root: Path = _CGROUPS, own: Path = Path("/proc/self/cgroup")) -> list[int]:
    """Return what the limits of the control groups of this process leave (containers, Slurm; version 2 of Linux'
    groups)."""
    try:
        name = next(line[3:] for line in own.read_text().splitlines() if line.startswith("0::"))
    except (OSError, StopIteration):
        return []
    left = []
    for folder in {root, root / name.strip("/")}:
        with contextlib.suppress(OSError, ValueError):  # "max" is no limit
            limit = int((folder / "memory.max").read_text())
            figures = dict(line.split() for line in (folder / "memory.stat").read_text().splitlines())
            used = int((folder / "memory.current").read_text()) - int(figures.get("inactive_file", 0))
            left.append(limit - used)
    return left


def budget_of(gigabytes: float, free: int | None = None) -> float:
    """Return the memory budget of a job in bytes: the user's limit, else :data:`DEFAULT_SHARE` of the free memory."""
    return gigabytes * GB if gigabytes else DEFAULT_SHARE * (free_memory() if free is None else free)


def allow(budget: float, folder: Path | None = None, strict: bool = False) -> None:
    """Set the bytes that this process may use from now on, see :func:`share`.

    Args:
        folder: for what does not fit into memory.
        strict: whether work that cannot stay below is to be refused, see :func:`require`.
    """
    global _allowed, _scratch, _strict
    _allowed, _scratch, _strict = budget, folder, strict


def scratch() -> Path | None:
    """Return the folder for data that does not fit into memory; None outside of a job."""
    return _scratch


def allowed() -> float:
    """Return the memory budget of this process in bytes."""
    return _allowed or budget_of(0.0)


def share(part: float, most: int) -> int:
    """Return a share (0..1) of the memory budget in bytes, and no more than ``most``."""
    return int(min(most, part * allowed()))


def at_once(bytes_each: float) -> int:
    """Return how many tasks fit into half of the memory left in the budget (another thread may use the other half).

    At least one: the memory of a single task is part of the job's estimate.
    """
    if not bytes_each:
        return sys.maxsize
    return max(1, int(0.5 * _left() / bytes_each))


def fits_beside(size: float) -> bool:
    """Tell whether a task of ``size`` bytes may run in the background: whether it fits into half of what is left.

    More than :data:`BESIDE` never does: it would save a few seconds, but the peaks of both tasks add up.
    """
    return size <= min(BESIDE, 0.5 * _left())


def require(size: float, what: str, cure: str) -> None:
    """Check that ``size`` bytes are left of the user's limit, after releasing cached memory.

    Raises:
        BadInput: they are not.
    """
    release_memory()
    if _strict and size > _left():
        raise BadInput(
            f"{what} need about {size / GB:.1f} GB of memory beside the {_taken() / GB:.1f} GB that the job holds, and "
            f"it may use {_allowed / GB:.1f} GB; {cure}, or allow more with --memory."
        )


def _left() -> float:
    """Return the bytes left in the budget, after those of this process and its workers."""
    return _allowed - _taken() if _allowed else budget_of(0.0)


def _taken() -> int:
    """Return the bytes that this process and its workers use now."""
    taken = psutil.Process().memory_info().rss
    for worker in tuple(RUNNING):
        with contextlib.suppress(psutil.Error):
            taken += psutil.Process(worker).memory_info().rss
    return taken


class MemoryMonitor:
    """Context manager that measures the peak memory of this process and its workers; bytes in ``peak``.

    On Linux the kernel's peak of this process is included, so that no short peak is missed.
    """

    def __init__(self) -> None:
        self.peak = 0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._follow, name="mgf-memory", daemon=True)

    def __enter__(self) -> MemoryMonitor:
        self._exact = _forget_peak()
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._ended.set()
        self._thread.join()
        self._sample()
        if self._exact:
            self.peak = max(self.peak, peak_memory())

    def _follow(self) -> None:
        while not self._ended.wait(_SAMPLE_SECONDS):
            self._sample()

    def _sample(self) -> None:
        self.peak = max(self.peak, _taken())


def _forget_peak() -> bool:
    """Have the system count this process's peak anew; False where it cannot."""
    if not sys.platform.startswith("linux"):
        return False
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return False
    return True
