# SPDX-License-Identifier: GPL-3.0-or-later
"""A job follows its process: messages, cancel, crash, rubbish, missing engine."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from pathlib import Path

import pytest

from mgf_blender.common import job as job_module
from mgf_blender.common.errors import UserError
from mgf_blender.common.job import CANCELLED, DONE, FAILED, Job


def make(tmp_path: Path, **more: object) -> Job:
    folder = tmp_path / "job"
    python = os.environ["MGF_ENGINE_PYTHON"]
    command = [python, "-m", "mgf_engine", "reconstruct", str(tmp_path), "--out", str(folder), "--cancel-on-eof"]
    return Job(command, folder, "house", **more)


def drain_until(job: Job, done, seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not done() and time.monotonic() < end:
        job.drain()
        time.sleep(0.01)
    assert done()


def test_runs_to_the_end(engine, tmp_path):
    messages, ends = [], []
    job = make(tmp_path, on_message=lambda j, m: messages.append(m["type"]), on_end=ends.append)
    assert job.run() == 0
    assert (job.status, job.overall, job.figures) == (DONE, 1.0, {"psnr": 27.5})
    assert messages[0] == "started" and messages[-1] == "result" and messages.count("stage") == 5
    assert job.warnings == ["Two photos are blurred; they count less."]
    assert ends == [job] and job.log.endswith("log.txt")


def test_cancel_is_resumable(engine, tmp_path):
    engine("slow")
    job = make(tmp_path)
    job.start()
    drain_until(job, lambda: job.stage == "scene")
    job.cancel()
    drain_until(job, lambda: not job.live)
    assert job.status == CANCELLED and job.exit_code == 3 and "resume" in job.text.lower()


def test_an_engine_that_will_not_stop_is_killed(engine, tmp_path, monkeypatch):
    engine("stubborn")
    monkeypatch.setattr(job_module, "PATIENCE", 0.3)
    job = make(tmp_path)
    job.start()
    drain_until(job, lambda: job.stage == "scene")
    job.cancel()
    drain_until(job, lambda: not job.live)
    assert job.status == CANCELLED


def test_kill_9_is_one_sentence(engine, tmp_path):
    engine("slow")
    job = make(tmp_path)
    job.start()
    drain_until(job, lambda: job.stage == "scene")
    os.kill(job.process.pid, signal.SIGKILL)
    drain_until(job, lambda: not job.live)
    assert (
        job.status == FAILED and "signal 9" in job.text and "press Reconstruct" in job.text and job.text.count(".") == 1
    )


def test_silent_death_names_the_last_words(engine, tmp_path):
    engine("silent")
    job = make(tmp_path)
    job.run()
    assert job.status == FAILED and job.exit_code == 77 and "Segmentation fault in kernel" in job.text


@pytest.mark.parametrize(("mode", "words"), [("bad", "no photos"), ("full", "The disk of ")])
def test_bad_input_is_said_as_the_engine_says_it(engine, tmp_path, mode, words):
    engine(mode)
    job = make(tmp_path)
    assert job.run() == 2
    assert job.status == FAILED and words in job.text


def test_rubbish_between_messages_is_ignored(engine, tmp_path):
    engine("noise")
    job = make(tmp_path)
    assert job.run() == 0 and job.status == DONE


def test_missing_program_and_wrong_environment(tmp_path):
    job = Job([str(tmp_path / "nowhere"), "-m", "mgf_engine"], tmp_path, "house")
    with pytest.raises(UserError, match="Cannot start"):
        job.run()
    assert job.status == FAILED
    job = Job([sys.executable, "-m", "mgf_engine", "reconstruct"], tmp_path, "house")
    job.run()
    assert job.status == FAILED and "has no MGF engine" in job.text


@pytest.mark.skipif(os.name == "nt", reason="stops the engine as Unix can")
def test_a_tick_does_not_wait_for_the_engine(engine, tmp_path):
    job = make(tmp_path)
    job.start()
    os.kill(job.process.pid, signal.SIGSTOP)
    rescue = threading.Timer(20.0, job.process.kill)  # of a tick that waits
    rescue.start()
    assert all(job.drain() for _ in range(1000)), "a tick waited for a message"
    rescue.cancel()
    os.kill(job.process.pid, signal.SIGCONT)
    drain_until(job, lambda: not job.live)
    assert job.status == DONE


def test_a_tick_takes_in_a_part_of_much_at_once(engine, tmp_path):
    """The window must not be held while an engine says more than can be shown."""
    job = make(tmp_path)
    warn = """print('{"v": 1, "type": "warning", "text": "%d"}' % number)"""
    job.command = [sys.executable, "-c", f"for number in range(1200): {warn}"]
    job.start()
    assert job.process.wait(20)
    taken = []
    while len(job.warnings) < 1200:
        before = job.messages + len(job.last_errors)
        job.drain()
        taken.append(job.messages + len(job.last_errors) - before)
    assert max(taken) == 500 and len(taken) >= 3


def test_the_engine_stops_when_its_owner_dies(engine, tmp_path):
    """Quitting or crashing Blender closes the pipe; the engine ends by itself and stays resumable."""
    import subprocess

    engine("slow")
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); from pathlib import Path\n"
        "from mgf_blender.common.job import Job\n"
        "job = Job(sys.argv[3:], Path(sys.argv[2]), 'x'); job.start(); print(job.process.pid, flush=True)\n"
        "import time; time.sleep(60)\n"
    )
    job = make(tmp_path)
    repo = str(Path(__file__).resolve().parents[3])
    owner = subprocess.Popen(
        [sys.executable, "-c", code, repo, str(job.folder), *job.command], stdout=subprocess.PIPE, text=True
    )
    pid = next(int(line) for line in owner.stdout if line.strip().isdigit())  # Blender 5.2 has things to say, too
    time.sleep(0.5)
    owner.kill()
    owner.wait()
    owner.stdout.close()
    for _ in range(100):
        if not _alive(pid):
            break
        time.sleep(0.1)
    assert not _alive(pid)


def _alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().split(")")[-1].split()[0] != "Z"
    except OSError:
        return False
