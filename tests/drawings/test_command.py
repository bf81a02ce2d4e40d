# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf drawings`` by its command line: what is drawn, and how it ends for a program that reads its messages."""

from __future__ import annotations

import io
import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from support.finished_job import FinishedJob

from mgf_engine.cli.main import main


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, list[dict[str, Any]]]:
    """Exit code and messages."""
    code = main(["drawings", *map(str, arguments), "--progress", "json"])
    return code, [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_only_what_was_asked_for_is_drawn(finished: FinishedJob, tmp_path: Path, capsys) -> None:
    out = tmp_path / "sections"
    wanted = ("--draw", "sections", "--section", "z=1", "--section", "A=1")
    code, messages = run(capsys, finished.folder, "--out", out, *wanted)
    assert code == 0 and messages[-1]["type"] == "result"
    assert {m["type"] for m in messages} >= {"stage", "progress", "warning", "result"}
    assert {p.name for p in out.iterdir()} == {
        *(f"section-{name}.{kind}" for name in ("z-1", "A-1") for kind in ("dxf", "svg")), "drawings.html",
        "drawings.json",
    }  # fmt: skip
    code, _ = run(capsys, finished.folder, "--out", out, "--draw", "quantities", "--draw", "elevations")
    names = {p.name for p in out.iterdir()}
    assert code == 0 and {"quantities.csv", "elevation-A.dxf", "deviation-A.tif"} <= names
    assert not any(name.startswith(("orthophoto", "section", "sheet")) for name in names)


def test_sheets_have_the_scale_that_was_asked_for(finished: FinishedJob, tmp_path: Path, capsys) -> None:
    code, _ = run(capsys, finished.folder, "--out", tmp_path / "out", "--draw", "sheets", "--scale", "1:40")
    facts = json.loads((tmp_path / "out" / "drawings.json").read_text())["files"]["sheet-lines-A.pdf"]
    assert code == 0 and facts["scale"] == 40
    code, messages = run(capsys, finished.folder, "--out", tmp_path / "none", "--draw", "sheets", "--scale", "10")
    assert code == 2 and not (tmp_path / "none").exists()
    assert messages[-1]["text"] == (
        "A drawing of 4.0 x 3.2 does not fit on A3 at 1:10; give --scale 20 or a larger sheet."
    )


def test_what_is_wrong_is_a_message_and_nothing_is_written(finished: FinishedJob, tmp_path: Path, capsys) -> None:
    before = sorted(p.name for p in finished.folder.iterdir())
    code, messages = run(capsys, finished.folder, "--section", "tower=3")
    assert code == 2 and messages[-1]["type"] == "failed" and messages[-1]["code"] == 2
    assert "--section takes NAME=DISTANCE with NAME one of z, A, B, C, D" in messages[-1]["text"]
    assert sorted(p.name for p in finished.folder.iterdir()) == before
    code, messages = run(capsys, tmp_path)
    assert code == 2 and messages[-1]["type"] == "failed"


def test_closing_standard_input_stops_it(finished: FinishedJob, tmp_path: Path, capsys, monkeypatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    code, messages = run(capsys, finished.folder, "--out", tmp_path / "out", "--cancel-on-eof")
    assert code == 3 and messages[-1]["text"] == "Cancelled; what was there before is unchanged."
    assert list(tmp_path.iterdir()) == []


def test_options_of_algorithms_come_from_the_job_and_from_set(finished: FinishedJob, tmp_path: Path, capsys) -> None:
    def roofs(*more: str, job: Path = finished.folder) -> int:
        code, _ = run(capsys, job, "--out", tmp_path / "out", "--draw", "quantities", "--resolution", "50", *more)
        assert code == 0
        return (tmp_path / "out" / "quantities.csv").read_text().count("roof ")

    assert roofs() > 0 and roofs("--set", "planar.least_area=1e9") == 0
    config, job = tmp_path / "options.json", tmp_path / "job"
    config.write_text('{"planar.least_area": 1e9}')
    assert roofs("--config", str(config)) == 0
    shutil.copytree(finished.folder, job)
    record = json.loads((job / "job.json").read_text())
    record["given"]["planar.least_area"] = 1e9
    (job / "job.json").write_text(json.dumps(record))
    assert roofs(job=job) == 0 and roofs("--set", "planar.least_area=400", job=job) > 0


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("tsdf.band=2", "'mgf drawings' does not use the option 'tsdf.band'"),
        ("max_faces=2", "'mgf drawings' does not use the option 'max_faces'"),
        ("planar.least_are=2", "Unknown option 'planar.least_are'"),
        ("planar.least_area=-2", "must be at least 0"),
        ("planar.least_area", "--set takes NAME=VALUE"),
    ],
)
def test_options_it_does_not_use_are_refused(finished: FinishedJob, tmp_path: Path, capsys, text, says) -> None:
    code, messages = run(capsys, finished.folder, "--out", tmp_path / "out", "--set", text)
    assert code == 2 and says in messages[-1]["text"] and not (tmp_path / "out").exists()
