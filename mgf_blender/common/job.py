# SPDX-License-Identifier: GPL-3.0-or-later
"""One job of the engine as Blender sees it: a process, its messages, and what they add up to.

The messages are JSON lines (``started``, ``stage``, ``progress``, ``preview``, ``warning``, ``result``, ``failed``).
:meth:`Job.drain` is a plain function: a timer calls it in the window, a loop calls it in batch runs and tests.
"""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .errors import sentence
from .process import Process
from .text import N_, tr

EXIT_DONE, EXIT_FAULT, EXIT_BAD_INPUT, EXIT_CANCELLED = 0, 1, 2, 3
QUEUED, RUNNING, CANCELLING, DONE, FAILED, CANCELLED = "QUEUED", "RUNNING", "CANCELLING", "DONE", "FAILED", "CANCELLED"
#: What is said where the preferences name a Python that has no engine.
NO_ENGINE = N_("The chosen environment has no MGF engine; install it or choose another one in the preferences.")
#: Kinds of jobs that go through the engine's stages and can be resumed.
RESUMABLE = ("reconstruct", "masks", "scene")
_LIVE = {QUEUED, RUNNING, CANCELLING}
#: A job asked to stop that has not ended after this many seconds is killed; its checkpoints stay.
PATIENCE = 30.0


@dataclass
class Job:
    """State of one run of the engine.

    Attributes:
        command: program and arguments.
        folder: the job folder.
        title: what people call it.
        kind: the engine's command: reconstruct, masks, scene, drawings, models, georef; or places, suggest.
        scene_key: names the Blender scene that asked for it.
        on_message: called with every message, on the thread that drains.
        on_end: called once when the job ends, on the thread that drains.
    """

    command: Sequence[str]
    folder: Path
    title: str
    kind: str = "reconstruct"
    scene_key: str = ""
    on_message: Callable[[Job, dict[str, Any]], None] | None = None
    on_end: Callable[[Job], None] | None = None

    status: str = QUEUED
    stage: str = ""
    stage_index: int = 0
    stage_count: int = 0
    cached: bool = False  # whether a stage used an earlier result
    fraction: float = 0.0
    overall: float = 0.0
    seconds_left: float | None = None  # of all stages
    speed: float | None = None  # of this machine, as the engine learned it
    figures: dict[str, Any] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    messages: int = 0  # taken in so far
    preview: str = ""  # file of the newest picture
    preview_stage: str = ""  # that made it
    text: str = ""
    log: str = ""
    exit_code: int | None = None
    last_errors: deque[str] = field(default_factory=lambda: deque(maxlen=40))
    process: Process | None = None
    seconds: float = 0.0  # from the start to the end
    _begun: float = 0.0
    _stop_asked: float = 0.0
    _ended_by_message: bool = False

    @property
    def live(self) -> bool:
        """Whether the job waits or runs."""
        return self.status in _LIVE

    def start(self) -> None:
        """Start the process.

        Raises:
            UserError: the program cannot be started; the job is then FAILED and has ended.
        """
        try:
            self.process = Process(self.command)
        except Exception as error:
            self._end(FAILED, sentence(error), EXIT_FAULT)
            raise
        self.status, self._begun = RUNNING, time.monotonic()

    def cancel(self) -> None:
        """Ask the job to stop; what it has done stays resumable."""
        if self.status == QUEUED:
            self._end(CANCELLED, tr("Cancelled before it started."), EXIT_CANCELLED)
        elif self.status == RUNNING and self.process is not None:
            self.status, self._stop_asked = CANCELLING, time.monotonic()
            self.process.ask_to_stop()

    def drain(self) -> bool:
        """Take in what the process said since the last call; returns whether the job is still live."""
        if self.process is None or not self.live:
            return self.live
        for stream, line in self.process.lines():
            self._take(stream, line)
        code = self.process.returncode()
        if code is not None:
            self._finish(code)
        elif self._stop_asked and time.monotonic() - self._stop_asked > PATIENCE:
            self.process.kill()
        return self.live

    def run(self, poll: float = 0.05) -> int:
        """Start and drain until the end, for batch runs; returns the exit code."""
        self.start()
        try:
            while self.drain():
                time.sleep(poll)
        except KeyboardInterrupt:
            self.cancel()
            while self.drain():
                time.sleep(poll)
        return EXIT_FAULT if self.exit_code is None else self.exit_code

    def _take(self, stream: str, line: str) -> None:
        message = _parse(line) if stream == "out" else None
        if message is None:
            if line.strip():
                self.last_errors.append(line)
            return
        self.messages += 1
        self._apply(message)
        self._tell(self.on_message, message)

    def _apply(self, message: dict[str, Any]) -> None:
        kind = message["type"]
        if kind == "stage":
            self.stage, self.fraction = str(message.get("stage", "")), 0.0
            self.stage_index, self.stage_count = _number(message, "index"), _number(message, "count")
            self.figures, self.cached = {}, self.cached or bool(message.get("cached"))
            self._ended_by_message = False  # what comes first in it may have had a result of its own
        elif kind == "progress":
            self.fraction, self.overall = _share(message, "fraction"), _share(message, "overall")
            left = message.get("job_seconds_left")
            self.seconds_left = float(left) if isinstance(left, int | float) else None
            self.figures = _mapping(message, "figures")
        elif kind == "preview":
            self.preview, self.preview_stage = str(message.get("path", "")), str(message.get("stage", self.stage))
        elif kind == "warning":
            self.warnings.append(str(message.get("text", "")))
        elif kind == "result":
            self.figures, self.overall, self._ended_by_message = _mapping(message, "figures"), 1.0, True
            speed = message.get("speed")
            self.speed = float(speed) if isinstance(speed, int | float) else None
        elif kind == "failed":
            self.text, self.log = str(message.get("text", "")), str(message.get("log") or "")
            self._ended_by_message = True

    def _finish(self, code: int) -> None:
        self.exit_code = code
        if code == EXIT_DONE:
            self._end(DONE, "", code)
        elif code == EXIT_CANCELLED or (self._stop_asked and not self._ended_by_message):
            self._end(CANCELLED, self.text or tr("Cancelled; press Resume to continue."), EXIT_CANCELLED)
        elif self._ended_by_message:
            self._end(FAILED, self.text, code)
        else:
            self._end(FAILED, self._silent_end(code), code)

    def _silent_end(self, code: int) -> str:
        """Return one sentence for an engine that ended without saying why."""
        missing = next((e for e in self.last_errors if "No module named" in e and "mgf_engine" in e), None)
        if missing is not None:
            return tr(NO_ENGINE)
        error = next((e for e in reversed(self.last_errors) if e.strip()), "")
        if self.kind not in RESUMABLE:
            text = N_("The engine ended with code {code} ({error}); try again, and report it if it happens twice.")
            return tr(text, code=code, error=error.strip() or tr("no reason given"))
        if code < 0:
            text = N_("The engine was ended by signal {code}; press Resume to continue from the last checkpoint.")
            if code == -9:
                text = N_(
                    "The engine was ended by signal 9, mostly for lack of memory; "
                    "lower Resolution or Max Gaussians and press Reconstruct Building."
                )
        elif error:
            text = N_("The engine ended with code {code} ({error}); press Resume to continue from the last checkpoint.")
        else:
            text = N_(
                "The engine ended with code {code} and gave no reason; "
                "press Resume to continue from the last checkpoint."
            )
        return tr(text, code=abs(code), error=error.strip())

    def _end(self, status: str, text: str, code: int) -> None:
        self.status, self.text, self.exit_code = status, text, code
        self.seconds = time.monotonic() - self._begun if self._begun else 0.0
        if not self.log and (self.folder / "log.txt").is_file():
            self.log = str(self.folder / "log.txt")
        self._tell(self.on_end)

    def fail(self, error: Exception) -> None:
        """End the job after a fault of the add-on that it cannot go on from."""
        if self.process is not None:
            self.process.kill()
        self._end(FAILED, sentence(error), EXIT_FAULT)

    def _tell(self, listener: Callable[..., None] | None, *news: object) -> None:
        """Call a listener; what goes wrong there joins the warnings, once, and the job goes on."""
        try:
            if listener is not None:
                listener(self, *news)
        except Exception as error:
            text = sentence(error)
            if text not in self.warnings:
                self.warnings.append(text)


def _parse(line: str) -> dict[str, Any] | None:
    """Return a message, or None for anything else a library may print."""
    if not line.startswith("{"):
        return None
    try:
        message = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return message if isinstance(message, dict) and isinstance(message.get("type"), str) else None


def _share(message: dict[str, Any], name: str) -> float:
    value = message.get(name, 0.0)
    return min(1.0, max(0.0, float(value))) if isinstance(value, int | float) else 0.0


def _number(message: dict[str, Any], name: str) -> int:
    value = message.get(name, 0)
    return value if isinstance(value, int) else 0


def _mapping(message: dict[str, Any], name: str) -> dict[str, Any]:
    value = message.get(name)
    return dict(value) if isinstance(value, dict) else {}
