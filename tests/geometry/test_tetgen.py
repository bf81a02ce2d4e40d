# SPDX-License-Identifier: GPL-3.0-or-later
"""How tetgen's process talks to the job, fails and ends."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mgf_engine.errors import BadInput, Cancelled
from mgf_engine.geometry import tetgen
from mgf_engine.geometry.tetgen import background_delaunay


def nothing() -> None:
    pass


def points(count: int) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(count, 3))


def worker(folder: Path, code: str) -> tuple[str, str]:
    """A command that does something else instead."""
    path = folder / "worker.py"
    path.write_text(code)
    return sys.executable, str(path)


@pytest.mark.parametrize(
    ("code", "sentence"),
    [("import sys; print('tetgen gave up.', file=sys.stderr); sys.exit(2)", "^tetgen gave up.$"),
     ("import os; os._exit(9)", "code 9.*lower max_gaussians")],
)  # fmt: skip
def test_a_process_that_fails_says_why(tmp_path, monkeypatch, code, sentence) -> None:
    monkeypatch.setattr(tetgen, "COMMAND", worker(tmp_path, code))
    with background_delaunay(points(50)) as made, pytest.raises(BadInput, match=sentence):
        made(nothing)


def test_a_process_may_say_more_than_a_pipe_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    talk = "import sys; sys.stderr.write('x' * 300_000); sys.stderr.flush(); sys.stdout.buffer.write(bytes(1_600_000))"
    monkeypatch.setattr(tetgen, "COMMAND", worker(tmp_path, talk))
    with background_delaunay(points(50)) as made:
        assert made(nothing).shape == (100_000, 4)


def test_a_process_that_ends_with_the_cancelled_job_is_no_fault(tmp_path, monkeypatch) -> None:
    ended = tmp_path / "ended"
    code = f"import os, signal; open({str(ended)!r}, 'w').close(); os.kill(os.getpid(), signal.SIGTERM)"
    monkeypatch.setattr(tetgen, "COMMAND", worker(tmp_path, code))

    def check() -> None:
        if ended.exists():
            raise Cancelled("enough")

    with pytest.raises(Cancelled), background_delaunay(points(50)) as made:
        made(check)


@pytest.mark.skipif(sys.platform == "win32", reason="sends signals as a terminal of Unix does")
def test_ctrl_c_reaches_the_job_and_not_its_process() -> None:
    """The signal goes to the whole group, as from a terminal; the process would end by it at once."""
    job = """
import os, signal, sys, numpy as np
from mgf_engine.geometry import tetgen

asked, polls_left = [], [5]
signal.signal(signal.SIGINT, lambda *_: asked.append(True))
tetgen.COMMAND = (sys.executable, "-c", "import sys; sys.stdin.read()")

def check():
    polls_left[0] -= bool(asked)
    if not polls_left[0]:
        raise SystemExit(3)

with tetgen.background_delaunay(np.random.default_rng(0).normal(size=(50, 3))) as made:
    os.killpg(0, signal.SIGINT)
    made(check)
"""
    done = subprocess.run([sys.executable, "-c", job], capture_output=True, text=True, process_group=0)
    assert done.returncode == 3, done.stderr
