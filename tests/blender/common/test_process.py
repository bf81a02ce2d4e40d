# SPDX-License-Identifier: GPL-3.0-or-later
"""What a child writes arrives line by line and whole, without a thread and without a file left behind."""

from __future__ import annotations

import re
import sys
import tempfile
import threading
import time
from pathlib import Path

import pytest

import mgf_blender
from mgf_blender.common.errors import UserError
from mgf_blender.common.process import Process


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def read(process: Process, most: int = 500) -> list[tuple[str, str]]:
    found, end = [], time.monotonic() + 20
    while process.returncode() is None and time.monotonic() < end:
        part = process.lines(most)
        assert len(part) <= most
        found += part
    assert process.returncode() is not None
    return found


def python(code: str) -> Process:
    return Process([sys.executable, "-c", code])


def test_lines_of_both_streams_and_the_exit_code(temporary):
    process = python("import sys; print('a\\nbé\\r'); print('no', file=sys.stderr); print('last', end=''); sys.exit(3)")
    found = read(process)
    assert [t for s, t in found if s == "out"] == ["a", "bé", "last"] and ("err", "no") in found
    assert process.returncode() == 3 and process.lines() == [] and not list(temporary.iterdir())


def test_what_nobody_reads_holds_no_child_up(temporary):
    """Megabytes more than a pipe holds, read only after the end, in small portions."""
    process = python("for i in range(200_000): print(f'{i:030}')")
    assert process.wait(60)
    found = read(process, most=7000)
    assert [int(t) for _, t in found] == list(range(200_000))


def test_a_line_written_in_two_parts_is_one(temporary):
    process = python("import sys, time; sys.stdout.write('one '); sys.stdout.flush(); time.sleep(0.3); print('line')")
    assert read(process) == [("out", "one line")]


def test_bytes_that_are_no_text(temporary):
    process = python(r"import sys; sys.stdout.buffer.write(b'\xff\xfe\n')")
    assert read(process) == [("out", "\ufffd\ufffd")]


def test_no_thread_runs_beside_blender(temporary):
    before = threading.active_count()
    process = python("import time; print('on'); time.sleep(30)")
    assert threading.active_count() == before
    process.kill()
    read(process)


def test_a_program_that_is_not_there_leaves_no_file(temporary):
    with pytest.raises(UserError, match="Cannot start"):
        Process([str(temporary / "nothing")])
    assert not list(temporary.iterdir())


def test_the_add_on_imports_nothing_that_starts_threads():
    """Blender's Python supports no threads: one that ran beside an operator crashed it once in thirty random walks."""
    starts = re.compile(r"^\s*(?:import|from)\s+(?:threading|multiprocessing|concurrent|asyncio|_thread)\b", re.M)
    files = list(Path(mgf_blender.__file__).parent.rglob("*.py"))
    assert len(files) > 50
    assert [f.name for f in files if starts.search(f.read_text(encoding="utf-8"))] == []
