# SPDX-License-Identifier: GPL-3.0-or-later
"""A child process that never blocks Blender: threads read its output into a queue, :meth:`Process.lines` empties it."""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import IO

from .errors import UserError

_END = object()


def clean_environment() -> dict[str, str]:
    """The environment for a foreign Python: without Blender's own Python settings, UTF-8, unbuffered."""
    kept = {
        k: v
        for k, v in os.environ.items()
        if k not in {"PYTHONHOME", "PYTHONPATH", "PYTHONSTARTUP", "PYTHONEXECUTABLE"}
    }
    return {**kept, "PYTHONUTF8": "1", "PYTHONUNBUFFERED": "1", "PYTHONSAFEPATH": "1"}


class Process:
    """A running child with line-wise output.

    Closing its standard input is how it is asked to stop, on every system; the pipe also closes when Blender
    ends or crashes, so a job never outlives the window unnoticed.

    Args:
        command: program and arguments.
        cwd: working folder.

    Raises:
        UserError: the program cannot be started.
    """

    def __init__(self, command: Sequence[str], cwd: Path | None = None) -> None:
        self.command = list(command)
        self._queue: queue.SimpleQueue[object] = queue.SimpleQueue()
        options: dict[str, object] = {"start_new_session": True}
        if sys.platform == "win32":
            options = {"creationflags": subprocess.CREATE_NO_WINDOW | subprocess.CREATE_NEW_PROCESS_GROUP}
        try:
            self._popen = subprocess.Popen(
                self.command, cwd=cwd, env=clean_environment(), stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                stderr=subprocess.PIPE, **options,  # type: ignore[call-overload]
            )  # fmt: skip
        except OSError as error:
            reason = error.strerror or error
            raise UserError(
                "Cannot start '{command}' ({reason}); check the engine in the preferences.",
                command=self.command[0],
                reason=reason,
            ) from error
        self._open = 2
        for stream, name in ((self._popen.stdout, "out"), (self._popen.stderr, "err")):
            threading.Thread(target=self._read, args=(stream, name), daemon=True).start()

    @property
    def pid(self) -> int:
        """The child's process id."""
        return self._popen.pid

    def lines(self, most: int = 500) -> list[tuple[str, str]]:
        """Lines since the last call, as ("out" or "err", text); at most ``most``, so that one call stays short."""
        found: list[tuple[str, str]] = []
        while len(found) < most:
            try:
                item = self._queue.get_nowait()
            except queue.Empty:
                break
            if item is _END:
                self._open -= 1
            else:
                found.append(item)  # type: ignore[arg-type]
        return found

    def returncode(self) -> int | None:
        """The exit code once the child has ended and all its output was handed out, else None."""
        code = self._popen.poll()
        return code if code is not None and self._open <= 0 else None

    def ask_to_stop(self) -> None:
        """Close the child's standard input."""
        with contextlib.suppress(OSError, ValueError):
            if self._popen.stdin is not None:
                self._popen.stdin.close()

    def kill(self) -> None:
        """End the child at once, and on POSIX what it started: the pip that an environment is made with, a worker."""
        self.ask_to_stop()
        with contextlib.suppress(OSError):
            if sys.platform == "win32" or self._popen.poll() is not None:
                self._popen.kill()
            else:
                os.killpg(self._popen.pid, signal.SIGKILL)

    def wait(self, seconds: float) -> bool:
        """Wait for the child's end; True when it ended in time."""
        try:
            self._popen.wait(seconds)
        except subprocess.TimeoutExpired:
            return False
        return True

    def _read(self, stream: IO[bytes], name: str) -> None:
        with stream:
            for line in stream:
                self._queue.put((name, line.decode("utf-8", "replace").rstrip("\r\n")))
        self._queue.put(_END)
