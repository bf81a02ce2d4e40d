# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf georef`` as people read it, and what it leaves of a job for the next reconstruction."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from support.finished_job import finish_job
from support.jobs import finish_all
from support.live_terminal import HIDE, bar_ended, live_terminal
from support.survey import write_survey

from mgf_engine.cli.main import main
from mgf_engine.jobs.job import Job

PHOTOS = 8


@pytest.fixture
def surveyed(tmp_path: Path) -> Path:
    """A finished job without control points, beside points and marks of a survey."""
    finished = finish_job(tmp_path, PHOTOS)
    write_survey(tmp_path, finished.house, PHOTOS)
    with Job.start(finished.folder, resume=True) as job:
        finish_all(job)
    (finished.folder / "report.html").write_text("<main></main>")
    (finished.folder / "report.json").write_text("{}")
    (finished.folder / "deliver.json").write_text('{"mesh": "mesh.ply", "views": []}')
    return finished.folder


def georef(folder: Path, capsys: pytest.CaptureFixture[str], *more: str) -> str:
    """Run the command with the survey; returns what it said."""
    given = [f"--{name}={folder.parent / file}" for name, file in (("control", "points.csv"), ("marks", "marks.csv"))]
    return run(folder, capsys, *given, *more)[0]


def run(folder: Path, capsys: pytest.CaptureFixture[str], *given: str) -> tuple[str, str]:
    """Run the command; returns what it said on standard output and on standard error."""
    code = main(["georef", str(folder), "--progress", "plain", *given])
    said = capsys.readouterr()
    assert code == 0, said.err
    return said


def test_a_point_without_marks_has_no_figures(surveyed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with (surveyed.parent / "points.csv").open("a") as file:
        file.write("\nC9,691234,5334876,519,0.01,check\n")
    line = next(line for line in georef(surveyed, capsys).splitlines() if " C9 " in line)
    assert "not marked in any photo" in line and "nan" not in line and "px" not in line


def test_what_it_says_of_the_cameras_holds(surveyed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command that it names has the next run adjust the cameras; one without redoes nothing."""
    said = georef(surveyed, capsys)
    named = re.search(r"'mgf reconstruct --resume( --control-adjust)?' adjusts them", said)
    with Job.start(surveyed, resume=True) as job:
        assert job.done("scene")
    with Job.start(surveyed, user_options={"control_adjust": True} if named and named[1] else {}, resume=True) as job:
        assert named and job.adjusts_to_control and not job.done("scene")


def test_a_job_whose_cameras_were_adjusted_stays_one(surveyed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = surveyed.parent
    survey = {name: str(folder / f"{file}.csv") for name, file in (("control", "points"), ("marks", "marks"))}
    with Job.start(surveyed, user_options=survey, resume=True) as job:
        finish_all(job)
    assert "cameras stayed" not in georef(surveyed, capsys)
    (folder / "points.csv").write_text((folder / "points.csv").read_text().replace(",0.01,", ",0.02,"))
    assert "'mgf reconstruct --resume' adjusts them" in georef(surveyed, capsys)
    with Job.start(surveyed, resume=True) as job:
        assert job.adjusts_to_control and not job.done("scene") and not job.done("deliver")


def test_scale_bars_leave_adjusted_cameras_as_they_are(surveyed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = surveyed.parent
    survey = {name: str(folder / f"{file}.csv") for name, file in (("control", "points"), ("marks", "marks"))}
    with Job.start(surveyed, user_options=survey, resume=True) as job:
        finish_all(job)
    (folder / "bars.csv").write_text("from,to,metres\nP1,P2,10.0\n")
    said = georef(surveyed, capsys, f"--scale-bars={folder / 'bars.csv'}")
    assert "bar P1" in said and "cameras stayed" not in said
    assert json.loads((surveyed / "job.json").read_text())["config"]["control_adjust"] is True
    with Job.start(surveyed, resume=True) as job:
        assert job.done("scene") and job.done("deliver")


def test_a_bar_that_gives_the_scale_is_off_by_nothing(surveyed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for length in ("7.3", "28.6", "0.7", "12.9", "3.1"):  # rounding makes some of them a hair too short
        (surveyed.parent / "bars.csv").write_text(f"from,to,metres\nP1,P2,{length}\n")
        said = georef(surveyed, capsys, "--control=", f"--scale-bars={surveyed.parent / 'bars.csv'}")
        assert "bar P1" in said and "(+0.0 mm)" in said


def test_the_bar_ends_before_the_residuals(
    surveyed: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    live_terminal(monkeypatch)
    out, err = run(surveyed, capsys, "--progress", "bar")
    assert bar_ended(err) and "100%" in err
    assert "found by: " in out and "Written to" in out and HIDE not in out
