# SPDX-License-Identifier: GPL-3.0-or-later
"""The mask of one photo from its own clicks, within seconds: the engine's ``preview`` command.

It runs beside the queue of jobs, so a long job does not hold it up; the newest request replaces a running one. The
draw handler calls :func:`note_clicks`, which is how every change of the clicks is seen (a click, a drag, undo, a loaded
file) without a hook at each of them.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path

import bpy

from ..common.addon import preferences
from ..common.errors import UserError, sentence
from ..common.job import DONE, FAILED, NO_ENGINE, RUNNING
from ..common.process import Process
from ..common.runner import redraw
from ..common.text import N_, tr
from ..engine.environment import engine_command
from ..scene_keys import key_of, scene_key, scene_of
from . import files

_TICK = 0.1  # seconds between two looks at the process
_QUIET = 0.35  # seconds without a change of the clicks before an automatic preview starts

_latest: dict[tuple[str, str], Preview] = {}  # (scene key, photo) -> its newest preview
_finished: dict[tuple[str, str], Preview] = {}  # the same -> the one before that has a mask
_wanted: dict[tuple[str, str], float] = {}  # the same -> when an automatic preview is due
_seen: dict[tuple[str, str], str] = {}  # the clicks that :func:`note_clicks` saw last
_count = 0


@dataclass
class Preview:
    """One run of the engine for one photo.

    Attributes:
        photo: name of the photo.
        clicks: what :func:`signature` gave when it started.
        mask: the PNG it writes, 255 on the building, in the frame of the user's photo.
        text: why it failed, as one sentence.
        seconds: how long it took.
    """

    photo: str
    clicks: str
    mask: Path
    process: Process
    begun: float
    status: str = RUNNING
    text: str = ""
    seconds: float = 0.0

    def drain(self) -> bool:
        """Take in what the process said; returns whether it still runs."""
        if self.status != RUNNING:
            return False
        for stream, line in self.process.lines():
            if stream == "err" and line.strip():
                self.text = line.strip().removeprefix("Error: ")
        code = self.process.returncode()
        if code is None:
            return True
        self.seconds = time.monotonic() - self.begun
        good = code == 0 and self.mask.is_file()
        self.status, self.text = (DONE, "") if good else (FAILED, self._reason(code))
        return False

    def _reason(self, code: int) -> str:
        if "No module named" in self.text and "mgf_engine" in self.text:
            return tr(NO_ENGINE)
        text = N_("The engine ended with code {code} and gave no reason; press Check Engine in the preferences.")
        return self.text or tr(text, code=code)


def signature(photo: bpy.types.PropertyGroup) -> str:
    """Return the clicks of a photo as text, to see whether they changed."""
    return json.dumps(
        [[round(c.uv[0], 1), round(c.uv[1], 1), c.negative, c.part] for c in photo.clicks if not c.proposed]
    )


def shares_clicks(found: Preview, photo: bpy.types.PropertyGroup) -> bool:
    """Tell whether a preview came of at least one of the photo's present clicks: not after they were all replaced."""
    now = json.loads(signature(photo))
    return any(click in now for click in json.loads(found.clicks))


def start(scene: bpy.types.Scene, photo: bpy.types.PropertyGroup) -> Preview:
    """Ask the engine for the mask of a photo; a preview that still runs is ended.

    Raises:
        UserError: no click on the building, no engine, or the temporary folder cannot be written.
    """
    global _count
    if not scene.mgf.source:
        raise UserError("The photo belongs to no imported scene; import photos or a COLMAP scene first.")
    if not photo.done():
        raise UserError("No point marks the building in this photo; click at least one.")
    folder = Path(bpy.app.tempdir) / "mgf_preview"
    _count += 1
    prompts, mask = folder / f"{_count}.json", folder / f"{_count}.png"
    files.write(scene, prompts, only=photo.name)
    command = ["preview", bpy.path.abspath(scene.mgf.source), "--prompts", str(prompts), "--image", photo.name]
    command += ["--out", str(mask), "--segmenter", scene.mgf.options.segmenter]
    prefs = preferences()
    weights = scene.mgf.options.weights or (prefs.weights_folder if prefs is not None else "")
    if weights:
        command += ["--weights", bpy.path.abspath(weights)]
    full = engine_command(*command)
    stop()
    found = Preview(photo.name, signature(photo), mask, Process(full), time.monotonic())
    key = scene_key(scene), photo.name
    if key in _latest and _latest[key].status == DONE:
        _finished[key] = _latest[key]
    _latest[key] = found
    _wake()
    return found


def newest(scene: bpy.types.Scene, photo: str) -> Preview | None:
    """Return the newest preview of a photo in a scene."""
    return _latest.get((key_of(scene), photo))


def finished(scene: bpy.types.Scene, photo: str) -> Preview | None:
    """Return the newest preview of a photo that has a mask, also while the next one runs."""
    latest = newest(scene, photo)
    return latest if latest is not None and latest.status == DONE else _finished.get((key_of(scene), photo))


def under_way(scene: bpy.types.Scene, photo: str) -> bool:
    """Tell whether a preview of a photo runs or is due."""
    found = newest(scene, photo)
    return (key_of(scene), photo) in _wanted or (found is not None and found.status == RUNNING)


def stop() -> None:
    """End the preview that runs, if one does."""
    for key, found in list(_latest.items()):
        if found.status == RUNNING:
            found.process.kill()
            del _latest[key]


def pump() -> bool:
    """Drain the running preview and start one that is due; returns whether there is more to do."""
    for found in _latest.values():
        try:
            found.drain()
        except Exception as error:  # Blender drops a timer whose function raises
            found.process.kill()
            found.status, found.text = FAILED, sentence(error)
    for key, due in list(_wanted.items()):
        if time.monotonic() >= due:
            del _wanted[key]
            _start_wanted(*key)
    return bool(_wanted) or any(p.status == RUNNING for p in _latest.values())


def note_clicks(scene: bpy.types.Scene, photo: bpy.types.PropertyGroup) -> None:
    """Note, while the photo is drawn, when its clicks changed and previews are automatic: one becomes due."""
    if not scene.mgf.auto_preview or not key_of(scene) or not photo.done():
        return
    key, now = (key_of(scene), photo.name), signature(photo)
    latest = _latest.get(key)
    if (latest is None or latest.clicks != now) and _seen.get(key) != now:
        _seen[key] = now
        _wanted[key] = time.monotonic() + _QUIET
        _wake()


def forget() -> None:
    """End everything and forget it: for disabling the add-on and for another file."""
    stop()
    for store in (_latest, _finished, _wanted, _seen):
        store.clear()


def _start_wanted(key: str, name: str) -> None:
    scene = scene_of(key)
    photo = scene.mgf.photos.get(name) if scene is not None else None
    if photo is None or not photo.done():
        return
    try:
        start(scene, photo)
    except Exception as error:
        scene.mgf.auto_preview = False  # the button says what is wrong; asking again at every click would not help
        sentence(error)


def _wake() -> None:
    if not bpy.app.background and not bpy.app.timers.is_registered(_tick):
        bpy.app.timers.register(_tick, first_interval=_TICK, persistent=True)


def _tick() -> float | None:
    alive = pump()
    redraw()
    return _TICK if alive else None


def register() -> None:
    """Do nothing: the timer starts with the first preview."""


def unregister() -> None:
    """Leave no process and no timer behind."""
    forget()
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
