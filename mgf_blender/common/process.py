# SPDX-License-Identifier: GPL-3.0-or-later
"""A child process that never blocks Blender: it writes to files, and :meth:`Process.lines` reads what is new in them.

No thread reads its output: Blender supports no threads of Python, and one that runs beside an operator crashes it now
and then. Nor does a pipe carry the output, since the child would stand still for as long as nobody reads.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import IO

from .errors import UserError, reason

_PIECE = 1 << 16  # bytes read at a time


def clean_environment() -> dict[str, str]:
    """Return the environment for a foreign Python: without Blender's own Python settings, UTF-8, unbuffered."""
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
        self._outputs: dict[str, _Output] = {}
        options: dict[str, object] = {"start_new_session": True}
        if sys.platform == "win32":
            options = {"creationflags": subprocess.CREATE_NO_WINDOW | subprocess.CREATE_NEW_PROCESS_GROUP}
        try:
            self._outputs.update((name, _Output()) for name in ("out", "err"))
            self._popen = subprocess.Popen(
                self.command, cwd=cwd, env=clean_environment(), stdin=subprocess.PIPE,
                stdout=self._outputs["out"].end, stderr=self._outputs["err"].end, **options,  # type: ignore[call-overload]
            )  # fmt: skip
        except OSError as error:
            self._close()
            raise UserError(
                "Cannot start '{command}' ({reason}); check the engine in the preferences.",
                command=self.command[0],
                reason=reason(error),
            ) from error
        for output in self._outputs.values():
            output.end.close()  # the child's alone from now on

    @property
    def pid(self) -> int:
        """The child's process id."""
        return self._popen.pid

    def lines(self, most: int = 500) -> list[tuple[str, str]]:
        """Return lines since the last call, as ("out" or "err", text); at most ``most``, so that one call stays
        short."""
        ended = self._popen.poll() is not None  # asked first: what it wrote by then is in the files
        found: list[tuple[str, str]] = []
        for name, output in self._outputs.items():
            found += ((name, line) for line in output.lines(most - len(found), ended))
        return found

    def returncode(self) -> int | None:
        """Return the exit code once the child has ended and all its output was handed out, else None."""
        code = self._popen.poll()
        if code is None or not all(output.handed_out() for output in self._outputs.values()):
            return None
        self._close()
        return code

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

    def _close(self) -> None:
        for output in self._outputs.values():
            output.close()


class _Output:
    """A file that a child writes to at its ``end``, and that is read line by line from its beginning."""

    def __init__(self) -> None:
        handle, self._path = tempfile.mkstemp(prefix="mgf-", suffix=".log")
        self.end: IO[bytes] = os.fdopen(handle, "ab", buffering=0)
        self._file: IO[bytes] = open(self._path, "rb")  # noqa: SIM115
        self._rest, self._lines = b"", list[str]()
        if sys.platform != "win32":  # there an open file cannot be removed
            os.unlink(self._path)

    def lines(self, most: int, ended: bool) -> list[str]:
        """Return the next lines, at most ``most``; a last one without a line break once the child has ``ended``."""
        while len(self._lines) < most and not self._file.closed:
            piece = self._file.read(_PIECE)
            *whole, self._rest = (self._rest + piece).split(b"\n")
            if ended and not piece and self._rest:
                whole, self._rest = [*whole, self._rest], b""
            self._lines += (line.decode("utf-8", "replace").rstrip("\r") for line in whole)
            if not piece:
                break
        found, self._lines = self._lines[:most], self._lines[most:]
        return found

    def handed_out(self) -> bool:
        """Tell whether nothing is left to read."""
        if not self._file.closed and not self._lines and not self._rest:
            place = self._file.tell()
            return place == os.fstat(self._file.fileno()).st_size
        return self._file.closed

    def close(self) -> None:
        self.end.close()
        self._file.close()
        if sys.platform == "win32":
            with contextlib.suppress(OSError):
                os.unlink(self._path)
