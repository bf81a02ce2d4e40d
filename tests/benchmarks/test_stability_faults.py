# SPDX-License-Identifier: GPL-3.0-or-later
"""Faults of the stability suite that hang on time: they must find the same on a busy machine."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import pytest

from benchmarks import stability_faults

#: A job that has its folder at once and ends after a quarter of a second.
JOB = """
import pathlib, sys, time
job = pathlib.Path(sys.argv[1])
job.mkdir()
(job / "job.json").write_text("{}")
time.sleep(0.25)
(job / "done").touch()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="processes are held by signals")
def test_others_are_turned_away_however_slowly_they_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    job = tmp_path / "two"

    def finish(house: object, folder: Path) -> tuple[int, dict, str]:
        time.sleep(0.2)
        return (0, {"text": ""}, "") if (folder / "done").exists() else (2, {"text": "The folder is in use."}, "")

    monkeypatch.setattr(stability_faults, "command", lambda *args: [sys.executable, "-c", JOB, str(job)])
    monkeypatch.setattr(stability_faults, "start_args", lambda *args: [])
    monkeypatch.setattr(stability_faults, "finish", finish)
    monkeypatch.setattr(stability_faults, "check_whole", lambda *args: None)
    said = stability_faults.two_processes(None, tmp_path, {})  # type: ignore[arg-type]
    assert "turned away" in said and (job / "done").exists()
