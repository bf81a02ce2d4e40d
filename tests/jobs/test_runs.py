# SPDX-License-Identifier: GPL-3.0-or-later
"""Results of earlier runs stay as they are until they are removed."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest
from filelock import FileLock

from mgf_engine.cli.main import main
from mgf_engine.errors import BadInput
from mgf_engine.files.atomic import atomic_path
from mgf_engine.jobs.job import Job
from mgf_engine.jobs.runs import keep_run, list_runs, remove_runs, renew_run

NAMES = ("mesh.ply", "texture.jpg", "renders", "field.ply")


@pytest.fixture
def job(tmp_path: Path) -> Path:
    (tmp_path / "photos").mkdir()
    Job.start(tmp_path / "job", tmp_path / "photos").close()
    return tmp_path / "job"


def run(job: Path, content: str) -> int:
    """A run whose files all hold the same text."""
    for name in ("mesh.ply", "texture.jpg", "renders/a.png"):
        with atomic_path(job / name) as temporary:
            temporary.write_text(content)
    views = [{"name": "a", "file": "scene/images/a.png", "render": "renders/a.png"}]
    views.append({"name": "b", "file": "scene/images/b.png", "render": None})
    manifest = {"views": views, "mesh": "mesh.ply", "texture": "texture.jpg", "figures": {"faces": 7, "psnr": 21.5}}
    return keep_run(job, NAMES, manifest, {"seed": len(content)})


def of(job: Path) -> dict:
    return json.loads((job / "deliver.json").read_text())


def test_the_present_result_follows_the_job_folder_and_earlier_ones_stay(job: Path) -> None:
    renew_run(job, ["mesh.ply"])  # there is none yet
    assert [run(job, text) for text in ("first", "second")] == [1, 2]
    with atomic_path(job / "mesh.ply") as temporary:
        temporary.write_text("third")
    with atomic_path(job / "renders" / "b.png") as temporary:
        temporary.write_text("third")
    (job / "texture.jpg").unlink()
    renew_run(job, ["mesh.ply", "renders", "texture.jpg", "nothing"])
    first, second = job / "runs" / "1", job / "runs" / "2"
    assert (first / "mesh.ply").read_text() == "first" and (second / "mesh.ply").read_text() == "third"
    assert sorted(path.name for path in (second / "renders").iterdir()) == ["a.png", "b.png"]
    assert (first / "texture.jpg").is_file() and not (second / "texture.jpg").exists()
    assert [path.name for path in (first / "renders").iterdir()] == ["a.png"]


@pytest.mark.parametrize("links", [True, False])
def test_what_an_earlier_run_gave_stays_when_a_later_one_ends(job: Path, links: bool, monkeypatch) -> None:
    def no_links(*paths: object) -> None:
        raise PermissionError(1, "Operation not permitted")  # as FAT says it

    if not links:
        monkeypatch.setattr(os, "link", no_links)
    assert [run(job, text) for text in ("first", "second", "third")] == [1, 2, 3]
    for number, text in enumerate(("first", "second", "third"), 1):
        for name in ("mesh.ply", "texture.jpg", "renders/a.png"):
            assert (job / "runs" / str(number) / name).read_text() == text
    assert (of(job)["mesh"], of(job)["texture"]) == ("runs/3/mesh.ply", "runs/3/texture.jpg")
    assert [v["render"] for v in of(job)["views"]] == ["runs/3/renders/a.png", None]
    assert of(job)["views"][0]["file"] == "scene/images/a.png"
    assert "field" not in of(job)
    own = of(job / "runs" / "1")
    assert (own["mesh"], own["views"][0]["render"], own["views"][0]["file"]) == ("mesh.ply", "renders/a.png", None)


def test_hard_links_take_no_room_of_their_own(job: Path) -> None:
    run(job, "x" * 100_000)
    assert list_runs(job)[0].size < 10_000
    run(job, "y" * 100_000)
    assert [r.size > 300_000 for r in list_runs(job)] == [True, False]


def test_half_of_a_run_is_none(job: Path) -> None:
    run(job, "first")
    (job / "runs" / "2").mkdir()
    (job / "runs" / "2" / "texture.jpg").write_text("half")
    (job / "runs" / "notes").mkdir()
    assert [r.number for r in list_runs(job)] == [1]
    assert run(job, "second") == 2
    assert (job / "runs" / "2" / "texture.jpg").read_text() == "second"


def test_half_of_a_run_that_cannot_be_removed_is_left_alone(job: Path, monkeypatch) -> None:
    (job / "runs" / "1").mkdir(parents=True)
    (job / "runs" / "1" / "texture.jpg").write_text("open elsewhere")
    monkeypatch.setattr(shutil, "rmtree", lambda path, ignore_errors: None)
    assert run(job, "first") == 2
    assert (job / "runs" / "1" / "texture.jpg").read_text() == "open elsewhere"
    assert [r.number for r in list_runs(job)] == [2]


@pytest.mark.parametrize(
    "text",
    ["", "[]", "[" * 100_000, '{"time": 1e300, "figures": {}, "given": {}}',
     '{"time": NaN, "figures": {}, "given": {}}',
     '{"time": 1, "figures": 3, "given": {}}', '{"time": 1, "figures": {"faces": [1]}, "given": {"a": {}}}'],
)  # fmt: skip
def test_a_damaged_record_is_no_run_and_no_fault(job: Path, text: str, capsys) -> None:
    run(job, "first")
    for name in ("01", "x", "2"):
        (job / "runs" / name).mkdir()
        (job / "runs" / name / "run.json").write_text(text)
    assert main(["clean", str(job)]) == 0
    assert capsys.readouterr().out.count("present result)") == 1
    assert {r.number for r in list_runs(job)} <= {1, 2}


def test_runs_are_listed_and_removed(job: Path, capsys) -> None:
    for text in ("a", "bb", "ccc", "dddd"):
        run(job, text)
    assert main(["clean", str(job)]) == 0
    shown = capsys.readouterr().out
    assert "seed=2" in shown and "21.5" in shown and shown.count("present result)") == 1
    assert main(["clean", str(job), "2"]) == 0
    assert [r.number for r in list_runs(job)] == [1, 3, 4]
    assert main(["clean", str(job), "--old"]) == 0
    assert [p.name for p in (job / "runs").iterdir()] == ["4"]
    assert (job / of(job)["mesh"]).read_text() == "dddd"
    assert run(job, "next") == 5


@pytest.mark.parametrize("arguments", [["3"], ["7"], ["1", "7"], ["1", "--old"]])
def test_what_cannot_be_removed_is_refused_and_all_stays(job: Path, arguments: list[str], capsys) -> None:
    for text in ("a", "b", "c"):
        run(job, text)
    assert main(["clean", str(job), *arguments]) == 2
    assert "Error: " in capsys.readouterr().err
    assert [r.number for r in list_runs(job)] == [1, 2, 3]


def test_nothing_is_removed_from_a_job_in_use(job: Path, capsys) -> None:
    run(job, "a")
    run(job, "b")
    with FileLock(str(job / ".lock")):
        assert main(["clean", str(job), "--old"]) == 2
    assert "in use" in capsys.readouterr().err
    assert main(["clean", str(job.parent / "photos")]) == 2
    assert len(list_runs(job)) == 2


def test_a_refused_removal_names_the_job(job: Path) -> None:
    run(job, "a")
    with pytest.raises(BadInput, match="present result"):
        remove_runs(job, [1])
