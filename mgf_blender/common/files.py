# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that are written whole or not at all, and the sentence when they cannot be."""

from __future__ import annotations

import contextlib
import errno
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from .errors import UserError, reason
from .text import tr

_PATIENCE = 1.0  # seconds in which a system says that it cannot open a file


def replace_file(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` fill a temporary file beside ``path`` and put it in its place.

    Raises:
        UserError: the folder or the file cannot be written, or the disk is full; an earlier file is then unchanged.
    """
    temporary = path.with_name(path.name + ".writing")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(temporary)
        os.replace(temporary, path)
    except (OSError, RuntimeError) as error:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise UserError(cannot_write(path, error)) from error


def open_file(path: Path) -> None:
    """Open a file or folder in the program that the system has for it, without waiting for the program's end: some
    desktops start a browser that way.

    Raises:
        UserError: there is none, or it did not start.
    """
    try:  # not by Blender's own operator, which says nothing when it fails
        if sys.platform == "win32":
            os.startfile(path)
        else:
            program = "open" if sys.platform == "darwin" else "xdg-open"
            opening = subprocess.Popen([program, str(path)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            with contextlib.suppress(subprocess.TimeoutExpired):  # it opens, or has yet to say that it cannot
                if opening.wait(_PATIENCE):
                    raise OSError(opening.returncode, "nothing opens it")
    except OSError as error:
        raise UserError("No program of the system opens '{path}'; open it yourself.", path=path) from error


def cannot_write(path: Path, error: Exception) -> str:
    """Return one sentence for a file that could not be written."""
    if getattr(error, "errno", None) in {errno.ENOSPC, errno.EDQUOT} or "No space left" in str(error):
        return tr("The disk is full, '{path}' was not written; free some space and try again.", path=path)
    return tr("Cannot write '{path}' ({reason}); choose another folder.", path=path, reason=reason(error).strip())
