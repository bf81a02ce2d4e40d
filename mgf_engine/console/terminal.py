# SPDX-License-Identifier: GPL-3.0-or-later
"""Print messages for people and programs: a progress bar, plain lines, or JSON lines; and choose their streams."""

from __future__ import annotations

import contextlib
import io
import math
import os
import sys
import threading
from collections.abc import Callable

from mgf_engine.errors import EXIT_CANCELLED
from mgf_engine.messages import Message, Sink, encode


def prepare_streams() -> None:
    """Lead closed streams nowhere, and escape letters that standard output lacks, as on standard error."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def drop_output() -> None:
    """Lead what is still to be written nowhere: Python would complain at its end."""
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for stream in (sys.stdout, sys.stderr):
            os.dup2(nowhere, stream.fileno())


def make_sink(style: str) -> Sink:
    """Make the sink for ``--progress``: ``auto`` (bar on a terminal, else plain), ``bar``, ``plain``, ``json``,
    ``none``.

    ``none`` still says why a job failed.
    """
    if style == "auto":
        style = "bar" if sys.stderr.isatty() else "plain"
    makers: dict[str, Callable[[], Sink]] = {
        "bar": _Bar, "plain": _Plain, "json": lambda: _print_json, "none": lambda: _print_failure,
    }  # fmt: skip
    return makers[style]()


def format_duration(seconds: float | None) -> str:
    """Return seconds as people say them: ``42 s``, ``3 min 20 s``, ``1 h 5 min``; ``?`` where they are unknown."""
    if seconds is None or not math.isfinite(seconds):
        return "?"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


_LEFT_LETTERS = 23  # of "12 min 34 s left in all", beside a bar

_print_lock = threading.Lock()


def _print_json(message: Message) -> None:
    with _print_lock:
        sys.stdout.write(encode(message, sys.stdout.encoding or "utf-8") + "\n")
        sys.stdout.flush()


def _print_failure(message: Message) -> None:
    if message["type"] == "failed":
        print(_sentence(message), file=sys.stderr, flush=True)


def _sentence(message: Message) -> str | None:
    """Return what a plain log line says about a message; None for messages nobody needs to read."""
    kind = message["type"]
    if kind == "started":
        return f"Job folder: {message['job']}"
    if kind in ("device", "segmenter", "estimate", "stopping"):
        return str(message["text"])
    if kind == "stage":
        state = " (done earlier)" if message["cached"] else ""
        return f"[{message['index'] + 1}/{message['count']}] {message['stage']}{state}"
    if kind == "warning":
        return f"Warning: {message['text']}"
    if kind == "failed":
        where = f" (log: {message['log']})" if message["log"] else ""
        said = "" if message["code"] == EXIT_CANCELLED else "Error: "
        return f"{said}{message['text']}{where}"
    if kind == "result":
        figures = ", ".join(_figures(message))
        files = "\n".join(f"  {name}: {path}" for name, path in message["files"].items())
        done = f"Done in {format_duration(message['seconds'])}." if message["seconds"] >= 1 else "Done."
        return "\n".join((f"{done} {figures}".rstrip(), *([files] if files else []), *_suggestion(message)))
    return None


def _suggestion(message: Message) -> list[str]:
    """Say which photos to click next, where a scene was read without clicks or masks."""
    names = message.get("suggested")
    return [f"Click the building in some of these photos: {', '.join(names)}"] if names else []


def _left(message: Message) -> str:
    """Return the time left of the job; of the stage where the job has no estimate; nothing while both are unknown."""
    if message["job_seconds_left"] is not None:
        return f"{format_duration(message['job_seconds_left'])} left in all"
    return "" if message["seconds_left"] is None else f"{format_duration(message['seconds_left'])} left in this stage"


class _Plain:
    """One line per event and one per tenth of a stage, for logs and pipes."""

    def __init__(self) -> None:
        self._tenth = -1

    def __call__(self, message: Message) -> None:
        if message["type"] == "stage":
            self._tenth = -1
        text = _sentence(message)
        if message["type"] == "progress":
            tenth = int(message["fraction"] * 10)
            if tenth > self._tenth:
                self._tenth = tenth
                text = f"  {message['fraction']:4.0%}  {_left(message)}  {'  '.join(_figures(message))}".rstrip()
        if text is not None:
            print(text, file=sys.stderr, flush=True)


class _Bar:
    """A live bar with stage, share done, time left, and as many of the stage's figures as there is room for."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TaskID, TaskProgressColumn, TextColumn
        from rich.table import Column

        self._console = Console(stderr=True)
        width = min(40, max(16, self._console.width // 5))
        self._room = self._console.width - (9 + 1 + width + 1 + 4 + 1 + _LEFT_LETTERS + 1)
        self._progress = Progress(
            TextColumn("{task.description:<9}", table_column=Column(min_width=9, no_wrap=True)),
            BarColumn(width, table_column=Column(min_width=width)),
            TaskProgressColumn(table_column=Column(min_width=4, no_wrap=True)),
            TextColumn("{task.fields[left]}", table_column=Column(no_wrap=True)),
            TextColumn("{task.fields[figures]}", style="dim", table_column=Column(no_wrap=True)), console=self._console,
        )  # fmt: skip
        self._task: TaskID | None = None

    def __call__(self, message: Message) -> None:
        kind = message["type"]
        if kind == "stage":
            self._progress.start()
            self._task = self._progress.add_task(message["stage"], total=1.0, left="", figures="")
            if message["cached"]:
                self._progress.update(self._task, completed=1.0, left="done earlier")
        elif kind == "progress" and self._task is not None:
            left = "" if message["fraction"] >= 1 else _left(message)
            figures = _fitting(_figures(message), self._room)
            self._progress.update(self._task, completed=message["fraction"], left=left, figures=figures)
        elif kind in ("result", "failed"):
            self.close()
        text = None if kind == "stage" else _sentence(message)
        if text is not None:
            self._console.print(text, markup=False, highlight=False, soft_wrap=True)

    def close(self) -> None:
        """End the bar, which shows the cursor again."""
        if self._progress.live.is_started:  # or an empty line would be printed where the output is no terminal
            self._progress.stop()


def _fitting(figures: list[str], letters: int) -> str:
    """Return the first figures, as many as have room in a line of so many letters."""
    said = ""
    for figure in figures:
        longer = f"{said}  {figure}" if said else figure
        if len(longer) > letters:
            break
        said = longer
    return said


def _figures(message: Message) -> list[str]:
    """Return the numbers and texts among the figures of a message as people read them; what is unknown (None, NaN),
    lists and parts are left out."""
    said = []
    for key, value in message["figures"].items():
        name = key.replace("_", " ")
        if isinstance(value, bool):
            said.append(f"{name}: {'yes' if value else 'no'}")
        elif isinstance(value, str):
            said.append(f"{name}: {value}")
        elif isinstance(value, int):
            said.append(f"{name} {value:,}")
        elif isinstance(value, float) and math.isfinite(value):
            said.append(f"{name} {value:,.10g}")
    return said
