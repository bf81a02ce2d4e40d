# SPDX-License-Identifier: GPL-3.0-or-later
"""Messages of a running job: one schema for the terminal, the panel, the log and the tests.

A message is one JSON object on one line. Every message has ``v`` (schema version), ``type`` and ``time``
(seconds since the epoch). Types and their further keys:

===========  ==========================================================================================
started      ``job`` (folder), ``pid``, ``version``, ``stages`` (names in order)
device       ``device`` (cpu or cuda), ``text`` (one sentence: what was chosen, and why)
estimate     ``seconds`` (of all stages to come), ``bytes`` (the most memory), ``allowed`` (bytes that the job may use),
             ``stages`` (name -> seconds), ``text`` (one sentence)
segmenter    ``segmenter`` (random_walker or efficientsam), ``text`` (one sentence: what draws the masks, and the other)
stage        ``stage`` (name), ``index``, ``count``, ``cached`` (true: an earlier result is used)
progress     ``stage``, ``fraction`` (0..1 of the stage), ``overall`` (0..1 of the job), ``seconds_left`` (of the
             stage, null while unknown), ``job_seconds_left`` (of all stages, null without an estimate), ``figures``
             (name -> number or text)
preview      ``stage``, ``path`` (a picture worth showing now), ``title``
warning      ``text`` (one sentence: cause and cure)
result       ``path`` (job folder), ``files`` (name -> path), ``figures``, ``seconds`` (of the run), ``speed`` (time of
             this machine over that of the one that estimates were fitted on, as far as its jobs have told; else null),
             ``suggested`` (names of photos worth clicking; of a scene that was read without clicks or masks alone)
stopping     ``text`` (Ctrl-C was heard, and the job stops at its next step)
failed       ``code`` (exit code), ``text`` (one sentence), ``log`` (path of the log, or null)
===========  ==========================================================================================
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

from mgf_engine.errors import Cancelled
from mgf_engine.files.atomic import json_text
from mgf_engine.stages import STAGE_NAMES, STAGES

SCHEMA_VERSION = 1
#: Typical share of each stage in the time of a job, for the overall progress bar without an estimate.
STAGE_SHARE = {stage.name: stage.share for stage in STAGES}

_LEAST_SECONDS = 5.0  # expected for a stage: shorter ones do not measure the machine's pace
_PACES = (0.3, 3.0)  # bounds of that pace, as a factor of the estimate

Message = dict[str, Any]
Sink = Callable[[Message], None]

log = logging.getLogger("mgf")


@runtime_checkable
class Closable(Protocol):
    """A sink that shows something until it is closed; it may be closed twice."""

    def close(self) -> None:
        """End it."""


def encode(message: Message, encoding: str = "utf-8") -> str:
    """Return one message as one line of JSON that an encoding can hold, without the line end."""
    return json_text(message, encoding, separators=(",", ":"))


class Reporter:
    """Sends the messages of the stages to its sinks, and carries the request to cancel.

    Args:
        sinks: callables that take a message; called on the thread that reports.
        min_interval: seconds between two ``progress`` messages (the first and last of a stage always pass).
    """

    def __init__(self, *sinks: Sink, min_interval: float = 0.2) -> None:
        self.sinks = list(sinks)
        self.stage_name = ""
        self.stages: tuple[str, ...] = STAGE_NAMES
        self.warnings: list[str] = []
        self.expected: dict[str, float] = {}
        self._min_interval = min_interval
        self._last = 0.0
        self._started = self._stage_started = time.monotonic()
        self._pace = 1.0  # time taken over time expected, of the stage before
        self._reached = self._begun_at = 0.0  # of the overall bar: so far, and when the expectation was set
        self._cancel = threading.Event()

    def send(self, type: str, **fields: Any) -> None:
        """Send one message of the given type; a result tells the seconds since the reporter was made."""
        if type == "result":
            fields["seconds"] = round(time.monotonic() - self._started, 1)
        message: Message = {"v": SCHEMA_VERSION, "type": type, "time": round(time.time(), 3), **fields}
        for sink in self.sinks:
            sink(message)

    def close(self) -> None:
        """End what sinks show while work runs, such as a bar on the terminal: before other lines are printed, and
        however the work ended."""
        for sink in self.sinks:
            if isinstance(sink, Closable):
                sink.close()

    def expect(self, seconds: dict[str, float]) -> None:
        """Set the expected seconds of the remaining stages, for the time left and the overall progress bar."""
        self.expected, self._pace, self._begun_at = dict(seconds), 1.0, self._reached

    def stage(self, name: str, *, cached: bool = False) -> None:
        """Report that a stage begins, or that its earlier result is used (``cached``)."""
        self._learn_pace()
        self.stage_name, self._stage_started, self._last = name, time.monotonic(), 0.0
        self.send("stage", stage=name, index=self.stages.index(name), count=len(self.stages), cached=cached)

    def progress(self, fraction: float, seconds_left: float | None = None, **figures: float | int | str) -> None:
        """Report the progress of the current stage; raises :class:`Cancelled` after a request to cancel.

        Args:
            fraction: 0..1 of the stage.
            seconds_left: of the stage; estimated from the pace so far when not given.
            figures: what is worth reading beside the bar, name -> value.
        """
        self.check()
        now = time.monotonic()
        if now - self._last < self._min_interval and 0.0 < fraction < 1.0:
            return
        self._last = now
        elapsed = now - self._stage_started
        if seconds_left is None and fraction > 0.02 and elapsed > 2.0:
            seconds_left = elapsed * (1.0 - fraction) / fraction
        self.send(
            "progress",
            stage=self.stage_name,
            fraction=round(fraction, 4),
            overall=round(self._whole(fraction), 4),
            seconds_left=_rounded(seconds_left),
            job_seconds_left=_rounded(self._job_left(fraction, seconds_left)),
            figures=figures,
        )

    def preview(self, path: str, title: str) -> None:
        """Report a picture with an intermediate result."""
        self.send("preview", stage=self.stage_name, path=path, title=title)

    def warning(self, text: str) -> None:
        """Send a warning: one sentence with the cause and the cure."""
        log.warning(text)
        self.warnings.append(text)
        self.send("warning", text=text)

    def cancel(self) -> None:
        """Ask the job to stop at the next :meth:`check` (safe from signal handlers and other threads)."""
        self._cancel.set()

    @property
    def cancelled(self) -> bool:
        """Whether a stop was asked for."""
        return self._cancel.is_set()

    def check(self) -> None:
        """Raise :class:`Cancelled` if a stop was asked for.

        Raises:
            Cancelled: a stop was asked for.
        """
        if self._cancel.is_set():
            raise Cancelled("Cancelled; run again with --resume to continue.")

    def _job_left(self, fraction: float, stage_left: float | None) -> float | None:
        """Estimate the seconds until the last stage ends; None without an estimate of the job."""
        if not self.expected:
            return None
        if stage_left is None:
            stage_left = self._pace * self.expected.get(self.stage_name, 0.0) * (1.0 - fraction)
        later = self.stages[self.stages.index(self.stage_name) + 1 :] if self.stage_name in self.stages else ()
        return stage_left + self._pace * sum(self.expected.get(name, 0.0) for name in later)

    def _learn_pace(self) -> None:
        """Scale the estimates of later stages by actual over expected time of the last one: the machine may be busy."""
        expected = self.expected.get(self.stage_name, 0.0)
        if expected >= _LEAST_SECONDS:
            taken = time.monotonic() - self._stage_started
            self._pace = min(_PACES[1], max(_PACES[0], taken / expected))

    def _whole(self, fraction: float) -> float:
        """Return the share of the whole job that is done."""
        self._reached = self._begun_at + (1.0 - self._begun_at) * self._overall(fraction)
        return self._reached

    def _overall(self, fraction: float) -> float:
        shares = self.expected or STAGE_SHARE
        rest = 0.0 if self.expected else 1.0  # of stages that other commands have
        total = sum(shares.get(s, rest) for s in self.stages) or 1.0
        done = 0.0
        for name in self.stages:
            if name == self.stage_name:
                return (done + shares.get(name, rest) * fraction) / total
            done += shares.get(name, rest)
        return fraction


def _rounded(seconds: float | None) -> float | None:
    return None if seconds is None else round(seconds, 1)
