# SPDX-License-Identifier: GPL-3.0-or-later
"""Two environments side by side: a new engine is made beside the old one and takes its place once it was checked.

A virtual environment may be renamed as long as its programs are started through its Python, as we do.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from ..common.errors import UserError, reason
from ..common.process import Process

_REMOVE = "import shutil, sys\nfor folder in sys.argv[1:]: shutil.rmtree(folder, ignore_errors=True)"
_removal: Process | None = None


def unfinished(target: Path) -> Path:
    """Return where the environment for ``target`` is made."""
    return target.with_name(target.name + "-new")


def replace_engine(target: Path) -> None:
    """Make the finished environment the engine, and remove the one before.

    Raises:
        UserError: a program still uses the one before; it is kept as it was.
    """
    move_aside(target)
    try:
        unfinished(target).rename(target)
    except OSError as error:
        recover(target)
        raise _in_use(target, error) from error
    discard(_old(target))


def move_aside(target: Path) -> None:
    """Take the engine out of its place, in one step: it is whole or gone, never half there.

    Raises:
        UserError: a program still uses it.
    """
    wait_for_removal()
    recover(target)
    shutil.rmtree(_old(target), ignore_errors=True)  # what an earlier removal left
    if target.exists():
        try:
            target.rename(_old(target))
        except OSError as error:
            raise _in_use(target, error) from error


def recover(target: Path) -> None:
    """Put the engine from before back, after Blender ended in the middle of :func:`replace_engine`; panels that are
    drawn ask for it, so it removes nothing.

    Raises:
        UserError: a program uses it.
    """
    old = _old(target)
    if old.exists() and not target.exists():
        try:
            old.rename(target)
        except OSError as error:
            raise _in_use(target, error) from error


def discard(*folders: Path) -> None:
    """Remove environments by a process of its own, see :func:`discarding`: their thousands of files take seconds.

    Where none can start, for lack of memory say, Blender waits for those seconds: nothing is left behind, and an
    installation that went well does not fail for it.
    """
    global _removal
    wait_for_removal()
    found = [folder for folder in folders if folder.exists()]
    if not found:
        return
    try:
        _removal = Process([sys.executable, "-c", _REMOVE, *map(str, found)])
    except UserError:
        for folder in found:
            shutil.rmtree(folder, ignore_errors=True)


def discarding() -> bool:
    """Tell whether an environment is being removed; nothing may be made in its place meanwhile."""
    return _removal is not None and _removal.returncode() is None


def wait_for_removal() -> None:
    """Wait until nothing is being removed any more."""
    while _removal is not None and not _removal.wait(60.0):
        pass


def remove(target: Path) -> None:
    """Remove the engine and whatever an installation that did not end left.

    Raises:
        UserError: a program still uses it.
    """
    move_aside(target)
    discard(_old(target), unfinished(target))


def _old(target: Path) -> Path:
    return target.with_name(target.name + "-old")


def _in_use(target: Path, error: OSError) -> UserError:
    return UserError(
        "The engine in '{folder}' is in use ({reason}); close other Blender windows and try again.",
        folder=target,
        reason=reason(error),
    )
