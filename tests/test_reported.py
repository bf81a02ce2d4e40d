# SPDX-License-Identifier: GPL-3.0-or-later
"""Commands say each thing once, and leave the process that called them as it was."""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support.jobs import write_photo_folder

from mgf_engine.cli import main
from mgf_engine.errors import EXIT_CANCELLED, EXIT_DONE
from mgf_engine.messages import Reporter
from mgf_engine.reported import STOPPING, run_reported

SCRIPT = """
import argparse
from mgf_engine.reported import STOPPING, run_reported

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
            time.sleep(0.02)
        reporter.check()

    assert run_reported(argparse.Namespace(progress=style, cancel_on_eof=False), work) == EXIT_CANCELLED
    assert STOPPING + "\n" in "".join(said)
    assert capfd.readouterr().err.strip().endswith("Cancelled; what was there before is unchanged.")


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
