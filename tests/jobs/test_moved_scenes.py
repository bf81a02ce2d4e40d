# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene by another path, moved, or another scene in its place."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from mgf_engine.errors import BadInput
from mgf_engine.jobs.job import Job
from mgf_engine.stages import STAGE_NAMES
from tests.support.jobs import finish_all, redone


@pytest.mark.skipif(os.name == "nt", reason="making symbolic links takes rights that users of Windows lack")
def test_links_lead_to_the_same_inputs(tmp_path: Path, model: Path) -> None:
    link = tmp_path / "link"
    link.symlink_to(model, target_is_directory=True)
    with Job.start(link / "job", link) as job:
        finish_all(job)
        job.path("picture.png").write_bytes(b"1")
    with Job.start(model / "job", model, resume=True) as job:
        assert all(job.done(stage) for stage in STAGE_NAMES)
    photo = (model / "images" / "a.jpg").rename(tmp_path / "a.jpg")
    (model / "images" / "a.jpg").symlink_to(photo)
    assert redone(model / "job", lambda: photo.write_bytes(b"other"), model) == list(STAGE_NAMES)


@pytest.fixture
def second_name(source: Path, tmp_path: Path):
    """Another path of the source, which is no link: as letters in another case or a mapped drive give one."""
    place = tmp_path / "second name"
    place.mkdir()
    if subprocess.run(["mount", "--bind", source, place], capture_output=True).returncode:
        pytest.skip("this user may not give a folder a second name")
    yield place
    subprocess.run(["umount", place], check=True)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="mounts a folder a second time the way of Linux")
def test_another_path_of_the_same_scene_is_the_same_job(tmp_path: Path, model: Path, second_name: Path) -> None:
    with Job.start(model / "job", model) as job:
        finish_all(job)
    with Job.start(second_name / "job", second_name, resume=True) as job:
        assert all(job.done(stage) for stage in STAGE_NAMES)
    with pytest.raises(BadInput, match="scene itself"):
        Job.start(second_name, model)
    (tmp_path / "other").mkdir()
    with pytest.raises(BadInput, match="another scene"):
        Job.start(second_name / "job", tmp_path / "other", resume=True)


@pytest.mark.parametrize("inside", [False, True])
def test_a_scene_that_was_moved_is_the_same_job(tmp_path: Path, model: Path, inside: bool) -> None:
    place = model if inside else tmp_path
    with Job.start(place / "job", model, user_options={"resolution": 300}) as job:
        finish_all(job)
    moved = model.rename(tmp_path / "moved")
    folder = (moved if inside else tmp_path) / "job"
    with pytest.raises(BadInput, match="give the folder that it was moved to"):
        Job.start(folder, resume=True)
    with Job.start(folder, moved, user_options={"max_faces": 5}, resume=True) as job:
        assert (job.source, job.done("scene"), job.done("field"), job.done("mesh")) == (moved, True, True, False)
    with Job.start(folder, resume=True) as job:
        assert job.done("scene")


def test_an_interrupted_job_finds_its_moved_scene_again(tmp_path: Path, model: Path) -> None:
    with Job.start(tmp_path / "job", model) as job:
        job.begin("scene")
        job.path("scene", "sfm").mkdir(parents=True)
    with Job.start(tmp_path / "job", model.rename(tmp_path / "moved"), resume=True) as job:
        job.begin("scene")
        assert job.path("scene", "sfm").is_dir()


def test_another_scene_does_not_take_the_place_of_one_that_is_gone(tmp_path: Path, model: Path) -> None:
    with Job.start(tmp_path / "job", model) as job:
        finish_all(job)
    other = Path(shutil.copytree(model, tmp_path / "other"))
    (other / "images" / "a.jpg").write_bytes(b"another photo")
    model.rename(tmp_path / "away")
    with pytest.raises(BadInput, match="another scene"):
        Job.start(tmp_path / "job", other, resume=True)
    (tmp_path / "away").rename(model)
    with Job.start(tmp_path / "job", resume=True) as job:
        assert all(job.done(stage) for stage in STAGE_NAMES)


@pytest.mark.parametrize("resume", [False, True])
def test_a_job_that_was_refused_before_it_did_anything_gives_its_folder_to_another_scene(
    tmp_path: Path, model: Path, resume: bool
) -> None:
    (tmp_path / "mistyped").mkdir()
    with Job.start(tmp_path / "job", tmp_path / "mistyped") as job:
        job.begin("scene")
        job.path("log.txt").write_text("")
    with Job.start(tmp_path / "job", model, resume=resume) as job:
        assert job.source == model
        finish_all(job)
    (tmp_path / "third").mkdir()
    with pytest.raises(BadInput, match="another scene"):
        Job.start(tmp_path / "job", tmp_path / "third", resume=True)


def test_what_a_job_had_begun_is_not_given_to_another_scene(tmp_path: Path, model: Path) -> None:
    (tmp_path / "other").mkdir()
    with Job.start(tmp_path / "job", tmp_path / "other") as job:
        job.begin("scene")
        job.path("scene", "sfm").mkdir(parents=True)
    with pytest.raises(BadInput, match="another scene"):
        Job.start(tmp_path / "job", model)
