# SPDX-License-Identifier: GPL-3.0-or-later
"""Facts about this machine and process: cores, CPU time, memory, versions, the user's cache folder."""

from __future__ import annotations

import contextlib
import importlib.metadata
import importlib.util
import os
import platform
import sys
from pathlib import Path

import psutil

PACKAGES = (
    "torch", "numpy", "pycolmap", "onnxruntime", "opencv-contrib-python-headless", "scipy", "shapely", "libigl",
    "trimesh",
)  # fmt: skip


def cores() -> int:
    """Count the cores this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def cpu_seconds() -> float:
    """Measure the CPU time of this process and of its ended children so far, all threads together (on Windows without
    children)."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def peak_memory() -> int:
    """Return the largest resident memory of this process so far, in bytes."""
    if sys.platform == "win32":
        return int(psutil.Process().memory_info().peak_wset)
    with contextlib.suppress(OSError, ValueError, IndexError):
        # Linux hands ru_maxrss on to a started program: a job begun by a large Blender would look as large.
        status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
        return int(status.split("VmHWM:")[1].split()[0]) * 1024
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def release_memory() -> None:
    """Hand memory that is free in this process back to the system, where its C library (glibc) can.

    Each thread frees into a heap of its own, and what one keeps for later is of no use to the others.
    """
    if sys.platform.startswith("linux"):
        import ctypes

        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)


def total_memory() -> int:
    """Return bytes of memory in the machine."""
    return int(psutil.virtual_memory().total)


def cpu_name() -> str:
    """Return the processor's own name, as far as the system tells."""
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def user_cache() -> Path:
    """Return the user's folder for what can be made again; ``MGF_CACHE`` names another one."""
    if os.environ.get("MGF_CACHE"):
        return Path(os.environ["MGF_CACHE"])
    if os.name == "nt":
        base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "mgf"


def versions() -> dict[str, str]:
    """Return Python, system and package versions; a package that is not installed reads 'missing'."""
    found = {"python": platform.python_version(), "system": platform.platform()}
    for name in PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "missing"
    return found


def is_installed(module: str) -> bool:
    """Tell whether a module can be imported; packages of the extras may be missing."""
    return importlib.util.find_spec(module) is not None
