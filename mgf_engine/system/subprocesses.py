# SPDX-License-Identifier: GPL-3.0-or-later
"""Worker processes of a job: start them, wait for them, and end them with the job."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any

#: For Popen: Ctrl-C reaches the job alone, which then ends its workers; a worker that it ended first would look broken.
APART: dict[str, Any] = {"process_group": 0}
if sys.platform == "win32":
    APART = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
#: Process ids of the workers that run now; their memory is the job's.
RUNNING: set[int] = set()
_POLL_SECONDS = 0.3


@contextlib.contextmanager
def worker(command: Sequence[str], **how: Any) -> Iterator[subprocess.Popen[bytes]]:
    """Start a process that works for the job, as ``Popen`` does; leaving waits for its end, and does not ask for it."""
    with subprocess.Popen(command, **how, **APART) as process:
        RUNNING.add(process.pid)
        try:
            yield process
        finally:
            RUNNING.discard(process.pid)


def ended(process: subprocess.Popen[bytes]) -> bool:
    """Wait a moment, and tell whether the process has ended."""
    try:
        process.wait(_POLL_SECONDS)
    except subprocess.TimeoutExpired:
        return False
    return True


def wait_for(process: subprocess.Popen[bytes], check: Callable[[], None]) -> None:
    """Wait until the process has ended; ``check`` is called at once, every moment and at the end, and may raise to
    cancel."""
    check()
    while not ended(process):
        check()
    check()


def run_worker(command: Sequence[str], check: Callable[[], None]) -> int:
    """Run a worker that says nothing until its end, or until ``check`` raises; returns its exit code."""
    quiet = subprocess.DEVNULL
    with worker(command, stdin=subprocess.PIPE, stdout=quiet, stderr=quiet) as process:
        try:
            wait_for(process, check)
        finally:
            process.kill()
    return process.returncode


def end_with_the_job() -> None:
    """End the process when the job is gone: for a thread of the worker, whose stdin is a pipe that the job holds."""
    while os.read(0, 1024):  # not sys.stdin: its lock, held here, would stop the interpreter from ending
        pass
    os._exit(1)
