# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf georef`` on a job that another version of MGF finished: keys and options are others, its files are there."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.finished_job import finish_job
from support.jobs import finish_all

from mgf_engine.cli.main import main
from mgf_engine.jobs.job import Job
from mgf_engine.jobs.job_folder import with_algorithms_of_job
from mgf_engine.stages import STAGE_NAMES


@pytest.fixture
def older(tmp_path: Path) -> Path:
    """The job, with keys and an option that no version of today makes."""
    folder = finish_job(tmp_path, photos=6).folder
    with Job.start(folder, resume=True) as job:
        finish_all(job)
    (folder / "report.html").write_text("<main></main>")
    (folder / "report.json").write_text("{}")
    (folder / "deliver.json").write_text('{"mesh": "mesh.ply", "views": []}')
    record = json.loads((folder / "job.json").read_text())
    for name in STAGE_NAMES:
        record["stages"][name]["key"] = "of another version"
    record["given"] = {"smoothness": 3, "section_cuts.no_such_number": 0.1}
    (folder / "job.json").write_text(json.dumps(record))
    return folder


def georef(folder: Path, capsys: pytest.CaptureFixture[str], *given: str) -> tuple[int, str]:
    """Run the command; returns its exit code and what it said."""
    code = main(["georef", str(folder), "--progress", "plain", *given])
    said = capsys.readouterr()
    return code, said.out + said.err


def test_a_job_of_another_version_gets_its_georeference(older: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, said = georef(older, capsys)
    assert code == 0, said
    assert (older / "georef.json").is_file() and "smoothness, section_cuts.no_such_number are passed over" in said
    record = json.loads((older / "job.json").read_text())
    assert {entry["key"] for entry in record["stages"].values()} == {"of another version"}


def test_drawings_and_models_pass_over_what_they_do_not_know(older: Path) -> None:
    said: list[str] = []
    with_algorithms_of_job(older, {}, said.append)
    assert [text.count("section_cuts.no_such_number") for text in said] == [1]


@pytest.mark.parametrize("lost", ["mesh.ply", "report.json", "deliver.json", "scene/scene.npz"])
def test_a_lost_file_is_one_sentence(older: Path, lost: str, capsys: pytest.CaptureFixture[str]) -> None:
    (older / lost).unlink()
    before = (older / "job.json").read_bytes()
    code, said = georef(older, capsys)
    assert code == 2 and lost in said and "has lost" in said and "Traceback" not in said
    assert (older / "job.json").read_bytes() == before


def test_a_stage_that_never_ended_is_named(older: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record = json.loads((older / "job.json").read_text())
    del record["stages"]["mesh"]
    (older / "job.json").write_text(json.dumps(record))
    code, said = georef(older, capsys)
    assert code == 2 and "its stage 'mesh' has not ended" in said
