# SPDX-License-Identifier: GPL-3.0-or-later
"""Write files and folders whole or not at all: a process that is killed leaves no part of one in its place."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

_WINDOWS = os.name == "nt"
_WAITS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.4, 0.5)  # seconds


def _read_umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


_UMASK = _read_umask()


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


@contextmanager
def atomic_folder(folder: Path) -> Iterator[Path]:
    """Give a folder beside that takes the place of ``folder`` when the block ends well, and is removed otherwise."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    beside = Path(tempfile.mkdtemp(prefix=f".part-{folder.name}-", dir=folder.parent))
    try:
        yield beside
        beside.chmod(0o777 & ~_UMASK)  # mkdtemp makes private folders
        _replace_folder(beside, folder)
    except BaseException:
        shutil.rmtree(beside, ignore_errors=True)
        raise


def _replace_folder(new: Path, folder: Path) -> None:
    """Put a folder in the place of another one, which stays where it is if that fails."""
    if not folder.exists():
        put_in_place(new, folder)
        return
    old = Path(tempfile.mkdtemp(prefix=f".old-{folder.name}-", dir=folder.parent))
    try:
        put_in_place(folder, old / folder.name)
        put_in_place(new, folder)
    except BaseException:
        if not folder.exists():
            put_in_place(old / folder.name, folder)
        raise
    finally:
        shutil.rmtree(old, ignore_errors=True)


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
    for path in list(folder.rglob(".part-*")):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            with contextlib.suppress(OSError):
                path.unlink()
