# SPDX-License-Identifier: GPL-3.0-or-later
"""The queue of jobs and the one timer that keeps it going.

Only this module owns processes. Blender's data is never held here, only names and keys, so undo, file changes and
deleted objects cannot leave a dangling reference.
"""

from __future__ import annotations

import contextlib
import time

import bpy

from .errors import UserError
from .job import DONE, QUEUED, RESUMABLE, Job

TICK = 0.2  # seconds between two looks at the running job
_KEPT = 20  # finished jobs that stay listed

_jobs: list[Job] = []
_longest_tick = 0.0


def jobs(scene_key: str | None = None) -> list[Job]:
    """Return all jobs of this session, oldest first; those of one scene when a key is given."""
    return [j for j in _jobs if scene_key is None or j.scene_key == scene_key]


def live_job(scene_key: str, kinds: tuple[str, ...] | None = None) -> Job | None:
    """Return the scene's job that waits or runs."""
    return next((j for j in _jobs if j.live and j.scene_key == scene_key and (kinds is None or j.kind in kinds)), None)


def last_job(scene_key: str, kinds: tuple[str, ...] = RESUMABLE) -> Job | None:
    """Return the job of these kinds that a panel talks about: the one that waits or runs, else the newest."""
    found = [job for job in jobs(scene_key) if job.kind in kinds] if scene_key else []
    return next((job for job in found if job.live), found[-1] if found else None)


def submit(job: Job) -> None:
    """Queue a job; it starts when those before it have ended.

    Raises:
        UserError: another live job uses the same folder.
    """
    if any(j.live and j.folder == job.folder for j in _jobs):
        raise UserError("A job already runs in this folder; wait for it or cancel it.")
    _jobs.append(job)
    while len(_jobs) > _KEPT and not _jobs[0].live:
        _jobs.pop(0)
    if not bpy.app.timers.is_registered(_tick):
        bpy.app.timers.register(_tick, first_interval=0.0, persistent=True)


def forget(scene_key: str) -> None:
    """Forget how the jobs of a scene ended; those that wait or run stay."""
    _jobs[:] = [job for job in _jobs if job.live or job.scene_key != scene_key]


def pump() -> bool:
    """Drain the running job and start the next; returns whether anything is live. Tests and batch runs call it."""
    global _longest_tick
    begun = time.perf_counter()
    running = next((j for j in _jobs if j.live and j.status != QUEUED), None)
    if running is None:
        waiting = next((j for j in _jobs if j.status == QUEUED), None)
        if waiting is not None:
            _start(waiting)
    else:
        try:
            running.drain()
        except Exception as error:  # Blender drops a timer whose function raises, and with it every job
            running.fail(error)
        if running.status != DONE or not bpy.app.background:  # without a window the result is imported here and now
            _longest_tick = max(_longest_tick, time.perf_counter() - begun)
    return any(j.live for j in _jobs)


def longest_tick() -> float:
    """Return the longest time in seconds the timer held Blender's main thread."""
    return _longest_tick


def stop_all(seconds: float = 2.0) -> None:
    """End every job: ask, wait a little, kill. For disabling the add-on and for leaving Blender."""
    for job in _jobs:
        job.on_end = job.on_message = None
        job.cancel()
    for job in _jobs:
        if job.process is not None and not job.process.wait(seconds):
            job.process.kill()
    _jobs.clear()


def _start(job: Job) -> None:
    with contextlib.suppress(Exception):  # the job has ended and says why
        job.start()


def _tick() -> float | None:
    before = _news()
    alive = pump()
    if _news() != before:
        redraw()
    return TICK if alive else None


def _news() -> list[tuple[str, int]]:
    """Return what changes when a panel has something new to say."""
    return [(j.status, j.messages) for j in _jobs]


def redraw() -> None:
    """Redraw the sidebars that show jobs and the image editors that show previews.

    The viewport's own picture stays: drawing a large scene several times a second would take the engine's time.
    """
    for manager in bpy.data.window_managers:
        for window in manager.windows:
            for area in window.screen.areas:
                if area.type in {"IMAGE_EDITOR", "PREFERENCES"}:
                    area.tag_redraw()
                elif area.type == "VIEW_3D":
                    for region in (r for r in area.regions if r.type == "UI"):
                        region.tag_redraw()


def register() -> None:
    """Do nothing: the timer starts with the first job."""


def unregister() -> None:
    """Leave no process and no timer behind."""
    stop_all()
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
