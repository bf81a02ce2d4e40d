# SPDX-License-Identifier: GPL-3.0-or-later
"""The one task of the engine's environment: an installation, a check or a download, and the timer that drains it.

At most one runs; the last one stays, because the preferences say how it ended.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import bpy

from ..common.addon import preferences, user_folder
from ..common.runner import redraw
from . import swap
from .task import RUNNING, Task

_TICK = 0.2  # seconds between two looks at the task


@dataclass(frozen=True)
class _Current:
    """A task, its kind (install, check, gpu or weights), and what :func:`chosen_engine` gave when it began."""

    kind: str
    task: Task
    engine: tuple[str, str]


_current: _Current | None = None


def current() -> tuple[str, Task | None]:
    """Return kind and task of the running or last task: install, check, gpu or weights; empty and None without one."""
    return ("", None) if _current is None else (_current.kind, _current.task)


def is_running() -> bool:
    """Tell whether a task runs."""
    return _current is not None and _current.task.status == RUNNING


def installing() -> bool:
    """Tell whether an installation runs."""
    return _current is not None and _current.kind == "install" and is_running()


def chosen_engine() -> tuple[str, str]:
    """Return which engine the preferences choose: where it comes from, and its path where the user gave one."""
    prefs = preferences()
    source = prefs.engine_source if prefs is not None else "MANAGED"
    return source, prefs.engine_path if source == "EXISTING" else ""


def is_about_chosen_engine() -> bool:
    """Tell whether what the task says at its end is about the engine that is chosen now: another can have been chosen
    meanwhile."""
    return _current is None or _current.engine == chosen_engine()


def begin(kind: str, task: Task) -> None:
    """Run a task in the background; batch runs and tests call ``task.run()`` instead."""
    global _current
    _current = _Current(kind, task, chosen_engine())
    if not bpy.app.background and not bpy.app.timers.is_registered(_tick):
        bpy.app.timers.register(_tick, first_interval=_TICK / 2, persistent=True)


def cancel() -> None:
    """Stop the running task."""
    if _current is not None:
        _current.task.cancel()


def forget() -> None:
    """Drop what the last task said, which spoke of another engine than the present one; a running task stays."""
    global _current
    if not is_running():
        _current = None


def end() -> None:
    """Stop the running task with its timer, and forget it: for disabling the add-on."""
    if _current is not None:
        _current.task.cancel()
        while _drain(_current.task):  # what was installed so far is removed
            time.sleep(0.05)
    forget()
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)


def log_path() -> Path:
    """Return where installations and checks write their output."""
    return user_folder() / "engine-log.txt"


def _drain(task: Task) -> bool:
    try:
        return task.drain()
    except Exception as error:  # Blender drops a timer whose function raises, and nothing else could be begun
        task.fail(error)
        return False


def _tick() -> float | None:
    alive = _current is not None and _drain(_current.task)
    redraw()
    return _TICK if alive or swap.discarding() else None
