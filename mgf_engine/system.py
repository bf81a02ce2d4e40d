# SPDX-License-Identifier: GPL-3.0-or-later
"""Facts about this machine and process: cores, memory, versions; and writing files so that a kill loses nothing."""

from __future__ import annotations

import contextlib
import importlib.metadata
import importlib.util
import json
import os
import platform
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil

PACKAGES = (
    "torch", "numpy", "pycolmap", "onnxruntime", "opencv-contrib-python-headless", "scipy", "shapely", "libigl",
    "trimesh",
)  # fmt: skip


_WINDOWS = os.name == "nt"
_WAITS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.4, 0.5)  # seconds


def _read_umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


_UMASK = _read_umask()


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


def near_memory_limit(share: float = 0.7) -> bool:
    """Tell whether this process came near the limit of its address space (``ulimit -v``); False without one.

    Libraries fail in strange ways when the system denies them memory; this tells what the matter was.
    """
    if not sys.platform.startswith("linux"):
        return False
    import resource

    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY:
        return False
    with contextlib.suppress(OSError, ValueError, IndexError):
        status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
        return int(status.split("VmPeak:")[1].split()[0]) * 1024 > share * limit
    return False


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


def put_in_place(new: Path, path: Path) -> None:
    """Replace as ``os.replace``, waiting, on Windows, for a reader or a virus scanner to let go of the file (two
    seconds).

    Raises:
        OSError: the file cannot be replaced.
    """
    for wait in _WAITS if _WINDOWS else ():
        try:
            os.replace(new, path)
            return
        except PermissionError:
            time.sleep(wait)
    os.replace(new, path)


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Give a temporary path beside ``path`` that takes its place when the block ends well, and is removed otherwise."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=".part-", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        if os.name == "posix":
            temporary.chmod(0o666 & ~_UMASK)  # mkstemp makes private files; results are for everybody to open
        put_in_place(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def write_json(path: Path, data: Any) -> None:
    """Write JSON so that readers see the old file or the new one, never a part."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(json_text(data, indent=1).encode("utf-8"))


def json_text(data: Any, encoding: str = "utf-8", **how: Any) -> str:
    """Write JSON for an encoding; with escapes where that lacks a letter (UTF-8 lacks some of odd file names)."""
    text = json.dumps(data, ensure_ascii=False, **how)
    try:
        text.encode(encoding)
    except UnicodeEncodeError:
        return json.dumps(data, **how)
    return text


def sweep(folder: Path) -> None:
    """Remove what a killed process left half-written below ``folder``; only while nobody else writes there."""
    for path in folder.rglob(".part-*"):
        with contextlib.suppress(OSError):
            path.unlink()
