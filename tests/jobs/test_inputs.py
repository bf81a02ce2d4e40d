# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole runs with stages that only leave their files, while the user's files change under them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.jobs import write_photo_folder

from mgf_engine import pipeline
from mgf_engine.errors import BadInput
from mgf_engine.jobs.inputs import read_inputs
from mgf_engine.jobs.job import CLICKS, Job
from mgf_engine.messages import Reporter
from mgf_engine.stages import STAGE_NAMES, Stage, stage_named
from mgf_engine.system import memory

CAMERAS = "1 PINHOLE 4 4 1 1 2 2\n"
CLICK = '{"a.jpg": {"positive": [[1, 2]]}}'


@pytest.fixture
def source(tmp_path: Path) -> Path:
    folder = tmp_path / "scene"
    (folder / "images").mkdir(parents=True)
    (folder / "images" / "a.jpg").write_bytes(b"x")
    for name, text in {"cameras": CAMERAS, "images": "1 1 0 0 0 0 0 0 1 a.jpg\n\n", "points3D": ""}.items():
        (folder / f"{name}.txt").write_text(text)
    (folder / "clicks.json").write_text(CLICK)
    return folder


@pytest.fixture
def run(source: Path, monkeypatch):
    """Runs the job in a folder; ``middle`` maps a stage to what happens in its middle. Returns stages not cached."""
    monkeypatch.setattr(pipeline, "prepare", lambda config, reporter: None)

    def start(folder: Path, middle=None) -> list[str]:
        def stage(name: str):
            def work(job: Job, reporter: Reporter) -> dict:
                if name == "masks":
                    job.keep_clicks()
                for file in stage_named(name).required_outputs:
                    job.path(file).parent.mkdir(parents=True, exist_ok=True)
                    job.path(file).write_text("{}")
                if middle and name in middle:
                    middle[name]()
                if name == "deliver":
                    assert set(job.stages) == set(STAGE_NAMES[:-1])  # what the report shows
                return {}

            return work

        monkeypatch.setattr(Stage, "runner", lambda self: stage(self.name))
        sent: list[dict] = []
        with Job.start(folder, source, source / "clicks.json", user_options={"texture": False}, resume=True) as job:
            pipeline.run_job(job, Reporter(sent.append))
        return [m["stage"] for m in sent if m["type"] == "stage" and not m["cached"]]

    return start


@pytest.mark.parametrize("place", ["inside", "outside"])
@pytest.mark.parametrize("stage", STAGE_NAMES)
def test_a_file_saved_beside_the_photos_costs_nothing(
    source: Path, tmp_path: Path, run, stage: str, place: str
) -> None:
    folder = (source if place == "inside" else tmp_path) / "job"

    def save() -> None:
        for name in ("notes.txt", "more.json", "images/another.jpg"):
            (source / name).write_text(stage)

    assert run(folder, {stage: save}) == list(STAGE_NAMES)
    assert run(folder) == []


def test_a_photo_that_is_gone_changes_the_inputs_until_it_is_back(tmp_path: Path) -> None:
    folder = write_photo_folder(tmp_path / "scene")
    for name in ("b.jpg", "c.jpg", "d.jpg"):
        (folder / "images" / name).write_bytes(b"y")
    images = "".join(f"{k} 1 0 0 0 0 0 0 1 {name}.jpg\n\n" for k, name in enumerate("abcd", 1))
    for name, text in {"cameras": CAMERAS, "images": images, "points3D": ""}.items():
        (folder / f"{name}.txt").write_text(text)
    photo, aside, job = folder / "images" / "b.jpg", tmp_path / "b.jpg", tmp_path / "job"
    before = read_inputs(folder, None, None, job)
    photo.rename(aside)
    without = read_inputs(folder, None, None, job)
    assert without.names == before.names and without.scene != before.scene
    aside.rename(photo)
    assert read_inputs(folder, None, None, job) == before


@pytest.mark.parametrize("stage", STAGE_NAMES)
def test_a_photo_changed_in_the_middle_is_for_the_next_run(source: Path, tmp_path: Path, run, stage: str) -> None:
    photo = source / "images" / "a.jpg"
    assert run(tmp_path / "job", {stage: lambda: photo.write_bytes(b"other")}) == list(STAGE_NAMES)
    assert run(tmp_path / "job") == list(STAGE_NAMES)
    assert run(tmp_path / "job") == []


@pytest.mark.parametrize("stage", STAGE_NAMES)
def test_a_click_added_in_the_middle_is_for_the_next_run(source: Path, tmp_path: Path, run, stage: str) -> None:
    more = '{"a.jpg": {"positive": [[1, 2], [2, 2]]}}'
    assert run(tmp_path / "job", {stage: lambda: (source / "clicks.json").write_text(more)}) == list(STAGE_NAMES)
    assert (tmp_path / "job" / CLICKS).read_text() == CLICK
    assert run(tmp_path / "job") == list(STAGE_NAMES[1:])
    assert (tmp_path / "job" / CLICKS).read_text() == more


def test_clicks_that_are_gone_are_taken_from_the_job(source: Path, tmp_path: Path, run) -> None:
    assert run(tmp_path / "job") == list(STAGE_NAMES)
    (source / "clicks.json").unlink()
    with pytest.raises(BadInput, match=r"--prompts '.*job.prompts\.json'"):
        run(tmp_path / "job")
    kept = tmp_path / "job" / CLICKS
    with Job.start(tmp_path / "job", source, kept, resume=True) as job:
        assert all(job.done(stage) for stage in STAGE_NAMES)
        job.begin("masks")
        assert kept.read_text() == CLICK
    with Job.start(tmp_path / "job", source, kept, user_options={"vote_dilation": 1}, resume=True) as job:
        job.begin("masks")
        job.keep_clicks()
        assert kept.read_text() == CLICK


def test_clicks_given_anew_win_over_masks_given_before(source: Path, tmp_path: Path) -> None:
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "a.png").write_bytes(b"x")
    clicks = source / "clicks.json"
    Job.start(tmp_path / "job", source, None, tmp_path / "own").close()
    with Job.start(tmp_path / "job", resume=True) as job:
        assert job.masks == tmp_path / "own"
        with_masks = job.keys
    with Job.start(tmp_path / "job", source, clicks, resume=True) as job:
        assert (job.prompts, job.masks) == (clicks, None)
        assert job.keys["scene"] == with_masks["scene"] and job.keys["masks"] != with_masks["masks"]
    with Job.start(tmp_path / "job", source, None, tmp_path / "own", resume=True) as job:
        assert job.keys == with_masks  # clicks are not read where masks are given
    clicks.write_text("{}")
    with Job.start(tmp_path / "job", resume=True) as job:
        assert job.keys == with_masks


def test_masks_given_anew_win_over_clicks_given_before(source: Path, tmp_path: Path) -> None:
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "a.png").write_bytes(b"x")
    Job.start(tmp_path / "job", source, source / "clicks.json").close()
    with Job.start(tmp_path / "job", source, None, tmp_path / "own", resume=True) as job:
        assert (job.prompts, job.masks) == (None, tmp_path / "own")


def test_clicks_and_masks_together_are_refused(source: Path, tmp_path: Path) -> None:
    """One of them would be ignored without a word."""
    (tmp_path / "own").mkdir()
    with pytest.raises(BadInput, match="Give either --prompts or --masks, not both"):
        Job.start(tmp_path / "job", source, source / "clicks.json", tmp_path / "own")
    assert not (tmp_path / "job").exists()


def test_without_masks_neither_clicks_nor_masks_are_watched(source: Path, tmp_path: Path) -> None:
    with Job.start(tmp_path / "job", source, source / "clicks.json", user_options={"use_masks": False}) as job:
        keys = job.keys
    (source / "clicks.json").write_text("{}")
    with Job.start(tmp_path / "job", resume=True) as job:
        assert job.keys == keys


def test_clicks_of_earlier_masks_do_not_stay(source: Path, tmp_path: Path, run) -> None:
    run(tmp_path / "job")
    data = json.loads((tmp_path / "job" / "job.json").read_text())
    (tmp_path / "job" / "job.json").write_text(json.dumps({**data, "prompts": None}))
    with Job.start(tmp_path / "job", resume=True) as job:
        job.keep_clicks()
    assert not (tmp_path / "job" / CLICKS).exists()


def test_a_second_job_of_the_same_photos_does_not_disturb_the_first(source: Path, run) -> None:
    def second() -> None:
        with Job.start(source / "second", source, source / "clicks.json") as job:
            job.path("scene", "sparse").mkdir(parents=True)
            for name in ("cameras", "images", "points3D"):
                job.path("scene", "sparse", f"{name}.txt").write_text(CAMERAS)
            job.path("texture.jpg").write_bytes(b"no photo")

    assert run(source / "job", {"field": second}) == list(STAGE_NAMES)
    assert run(source / "job") == []
    assert set(json.loads((source / "second" / "job.json").read_text())["stages"]) == set()


def test_memory_limit_and_folder_of_a_job_end_with_it(source: Path, tmp_path: Path, run) -> None:
    """What a program does after a job neither writes to its folder nor keeps to its limit."""

    def refuse() -> None:
        assert memory.scratch() == tmp_path / "job" and memory._allowed
        raise BadInput("No surface.")

    with pytest.raises(BadInput):
        run(tmp_path / "job", {"mesh": refuse})
    assert memory.scratch() is None and not memory._allowed
    assert run(tmp_path / "job") == ["mesh", "deliver"]
    assert memory.scratch() is None and not memory._allowed
