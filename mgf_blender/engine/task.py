# SPDX-License-Identifier: GPL-3.0-or-later
"""Steps of plain commands run one after the other in the background, with a log: installing and checking."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..common.errors import UserError, sentence
from ..common.job import CANCELLED, DONE, FAILED, RUNNING
from ..common.process import Process


@dataclass(frozen=True)
class Step:
    """One command: what people read while it runs, the program with its arguments, and its share of the bar.

    Attributes:
        needed: without it the task has failed; else only a note is left.
    """

    title: str
    command: Sequence[str]
    share: float = 1.0
    needed: bool = True


@dataclass
class Task:
    """Runs steps; :meth:`drain` is called by a timer or a loop.

    Attributes:
        log: file that gets all output.
        explain: turns the last lines of a failed step into one sentence.
        on_end: called once at the end.
        note: why a step that is not needed failed, as one sentence.
        finish: called after the last step; its UserError makes the task a failed one.
    """

    steps: Sequence[Step]
    log: Path
    explain: Callable[[Step, list[str]], str]
    on_end: Callable[[Task], None] | None = None
    finish: Callable[[], None] | None = None
    status: str = RUNNING
    text: str = ""
    note: str = ""
    output: list[str] = field(default_factory=list)
    _at: int = -1
    _process: Process | None = None
    _cancelled: bool = False

    @property
    def title(self) -> str:
        """What the running step does."""
        return self.steps[min(max(self._at, 0), len(self.steps) - 1)].title

    @property
    def fraction(self) -> float:
        """Share of the steps behind us, 0..1."""
        total = sum(s.share for s in self.steps)
        return 1.0 if self.status == DONE else sum(s.share for s in self.steps[: max(self._at, 0)]) / total

    def drain(self) -> bool:
        """Take in output and go to the next step; returns whether the task still runs."""
        if self.status != RUNNING:
            return False
        if self._process is None:
            return self._end(CANCELLED, "Cancelled.") if self._cancelled else self._next()
        lines = [text for _, text in self._process.lines()]
        if lines:
            self.output += lines
            self._write(lines)
        code = self._process.returncode()
        if code is None:
            return True
        self._process = None
        if self._cancelled:
            return self._end(CANCELLED, "Cancelled.")
        if code != 0:
            step = self.steps[self._at]
            text = self.explain(step, self.output[-60:])
            if step.needed:
                return self._end(FAILED, text)
            self.note = text
        return self._next()

    def cancel(self) -> None:
        """Stop the running step."""
        self._cancelled = True
        if self._process is not None:
            self._process.kill()

    def fail(self, error: Exception) -> None:
        """End the task after a fault of the add-on that it cannot go on from."""
        if self._process is not None:
            self._process.kill()
        self.status, self.text = FAILED, sentence(error)

    def run(self) -> str:
        """Drain to the end, for batch runs; returns the status."""
        while self.drain():
            time.sleep(0.05)
        return self.status

    def _next(self) -> bool:
        self._at += 1
        if self._at >= len(self.steps):
            return self._finish()
        step = self.steps[self._at]
        self._write([f"== {step.title}: {' '.join(step.command)}"])
        try:
            self._process = Process(step.command)
        except UserError as error:
            return self._end(FAILED, str(error))
        return True

    def _finish(self) -> bool:
        try:
            if self.finish is not None:
                self.finish()
        except UserError as error:
            return self._end(FAILED, str(error))
        return self._end(DONE, "")

    def _end(self, status: str, text: str) -> bool:
        self.status, self.text = status, text
        self._write([f"== {status} {text}"])
        if self.on_end is not None:
            self.on_end(self)
        return False

    def _write(self, lines: list[str]) -> None:
        try:
            self.log.parent.mkdir(parents=True, exist_ok=True)
            with self.log.open("a", encoding="utf-8") as file:
                file.writelines(line + "\n" for line in lines)
        except OSError:
            pass  # a log that cannot be written must not stop the task; the panel shows the sentence anyway
