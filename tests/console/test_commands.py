# SPDX-License-Identifier: GPL-3.0-or-later
"""Commands say each thing once, and leave the process that called them as it was."""

from __future__ import annotations

import argparse
import io
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from support.jobs import write_photo_folder

from mgf_engine.cli.main import main
from mgf_engine.console.commands import STOPPING, run_reported
from mgf_engine.errors import EXIT_CANCELLED, EXIT_DONE
from mgf_engine.messages import Reporter

SCRIPT = """
import argparse
from mgf_engine.console.commands import STOPPING, run_reported

args = argparse.Namespace(progress="plain", cancel_on_eof=False)
raise SystemExit(run_reported(args, lambda reporter: reporter.warning("The roof is missing.")))
"""


def test_a_warning_is_printed_once_where_there_is_no_log() -> None:
    """Python's logging prints warnings that nobody takes; pytest takes them, so this needs a process of its own."""
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    assert (done.stdout + done.stderr).count("The roof is missing.") == 1


@pytest.mark.parametrize("style", ["plain", "bar"])
def test_ctrl_c_is_answered_at_once(style: str, capfd: pytest.CaptureFixture[str]) -> None:
    """The next step, where the work can stop, may be half a minute away; a live bar must not paint over the answer."""
    said: list[str] = []

    def work(reporter: Reporter) -> None:
        reporter.stages = ("scene",)
        reporter.stage("scene")
        signal.raise_signal(signal.SIGINT)
        end = time.monotonic() + 20
        while STOPPING not in "".join(said) and time.monotonic() < end:
            said.append(capfd.readouterr().err)
            time.sleep(0.5)  # what is written while it reads is lost
        reporter.check()

    assert run_reported(argparse.Namespace(progress=style, cancel_on_eof=False), work) == EXIT_CANCELLED
    assert STOPPING in "".join(said)
    assert capfd.readouterr().err.strip().endswith("Cancelled; what was there before is unchanged.")


def test_ctrl_c_stops_work_without_steps_where_nothing_can_be_lost() -> None:
    """A large mesh is read and modules are loaded between two steps, which takes many seconds on a busy machine."""
    seen: list[str] = []

    def work(reporter: Reporter) -> None:
        signal.raise_signal(signal.SIGINT)
        try:
            end = time.monotonic() + 60
            while time.monotonic() < end:
                time.sleep(0.01)
            seen.append("end")
        finally:
            seen.append("cleaned up")

    args = argparse.Namespace(progress="none", cancel_on_eof=False)
    assert run_reported(args, work, patience=0.1) == EXIT_CANCELLED
    assert seen == ["cleaned up"]


def test_the_end_of_standard_input_stops_work_that_is_far_from_a_step(monkeypatch) -> None:
    """Blender cancels so."""
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    seen = []

    def work(reporter: Reporter) -> None:
        try:
            end = time.monotonic() + 5
            while time.monotonic() < end:
                time.sleep(0.01)
            seen.append("end")
        finally:
            seen.append("cleaned up")

    args = argparse.Namespace(progress="none", cancel_on_eof=True)
    assert run_reported(args, work, patience=0.1) == EXIT_CANCELLED
    assert seen == ["cleaned up"]


def test_a_thread_that_is_waited_for_does_not_keep_ctrl_c_from_stopping() -> None:
    free = threading.Event()

    def work(reporter: Reporter) -> None:
        signal.raise_signal(signal.SIGINT)
        try:
            free.wait(60)
        finally:
            free.set()

    args = argparse.Namespace(progress="none", cancel_on_eof=False)
    assert run_reported(args, work, patience=0.1) == EXIT_CANCELLED


def test_no_second_ctrl_c_comes_to_work_that_has_stopped() -> None:
    def work(reporter: Reporter) -> None:
        signal.raise_signal(signal.SIGINT)
        reporter.check()

    args = argparse.Namespace(progress="none", cancel_on_eof=False)
    assert run_reported(args, work, patience=0.3) == EXIT_CANCELLED
    time.sleep(0.6)  # KeyboardInterrupt here would end the tests


SIGTERM_BESIDE_PYCOLMAP = """
import argparse, signal
from mgf_engine.console.commands import run_reported

def work(reporter):
    import pycolmap
    signal.raise_signal(signal.SIGTERM)
    reporter.check()

raise SystemExit(run_reported(argparse.Namespace(progress="plain", cancel_on_eof=False), work))
"""
SIGTERM_AT_THE_START = """
import signal, sys
from mgf_engine.cli import main as cli
from mgf_engine.jobs import job

def start(*args, **more):
    signal.raise_signal(signal.SIGTERM)
    return opened(*args, **more)

opened, job.Job.start = job.Job.start, start
sys.exit(cli.main(sys.argv[1:]))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends a process without asking it")
def test_sigterm_cancels_also_where_pycolmap_is_loaded() -> None:
    """pycolmap takes the signal when it is loaded, and would end the process with a stack of addresses."""
    done = subprocess.run([sys.executable, "-c", SIGTERM_BESIDE_PYCOLMAP], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (EXIT_CANCELLED, "Cancelled; what was there before is unchanged.\n")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends a process without asking it")
def test_sigterm_cancels_a_job_that_is_being_opened(tmp_path: Path) -> None:
    scene = write_photo_folder(tmp_path / "photos")
    command = [sys.executable, "-c", SIGTERM_AT_THE_START, "scene", str(scene), "--out", str(tmp_path / "job")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stderr.splitlines()[-1]) == (
        EXIT_CANCELLED, "Cancelled; run again with --resume to continue.",
    )  # fmt: skip


INTERRUPTED_IMPORT = """
import runpy, sys

class Interrupting:
    def find_spec(self, name, path=None, target=None):
        if name == "mgf_engine.cli.main":
            raise KeyboardInterrupt

sys.meta_path.insert(0, Interrupting())
runpy.run_module("mgf_engine", run_name="__main__")
"""


def test_ctrl_c_while_the_command_itself_is_loaded_is_no_traceback() -> None:
    done = subprocess.run([sys.executable, "-c", INTERRUPTED_IMPORT], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (EXIT_CANCELLED, "Cancelled.\n")


def test_ctrl_c_that_a_library_takes_for_a_fault_of_its_own_is_a_cancelled_command() -> None:
    """pycolmap says that it is not installed well when Ctrl-C comes while it is loaded."""

    def work(reporter: Reporter) -> None:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as error:
            raise ImportError("initialization failed") from error

    assert run_reported(argparse.Namespace(progress="none", cancel_on_eof=False), work) == EXIT_CANCELLED


@pytest.mark.parametrize("fails", [False, True])
def test_a_command_called_from_python_leaves_its_signal_handlers(fails: bool) -> None:
    """Ctrl-C in a notebook, and SIGTERM to a server, are the caller's again when the command has ended."""

    def work(reporter: Reporter) -> None:
        assert signal.getsignal(signal.SIGTERM) is not before[1] and signal.getsignal(signal.SIGINT) is not before[0]
        if fails:
            signal.raise_signal(signal.SIGINT)
            reporter.check()

    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    args = argparse.Namespace(progress="none", cancel_on_eof=False)
    assert run_reported(args, work) == (EXIT_CANCELLED if fails else EXIT_DONE)
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


def test_a_job_leaves_the_signal_handlers_of_its_caller(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    monkeypatch.setattr("mgf_engine.pipeline.run_job", lambda *_, **__: seen.append(signal.getsignal(signal.SIGTERM)))
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    scene = write_photo_folder(tmp_path / "photos")
    assert main(["reconstruct", str(scene), "--out", str(tmp_path / "job"), "--progress", "none"]) == EXIT_DONE
    assert len(seen) == 1 and seen[0] is not before[1]
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before
