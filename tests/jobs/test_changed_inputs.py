# SPDX-License-Identifier: GPL-3.0-or-later
"""Which changes of photos, models, clicks and masks make stages run again."""

from __future__ import annotations

from pathlib import Path

import pytest

from mgf_engine.errors import BadInput
from mgf_engine.jobs.job import Job
from mgf_engine.scene.colmap import PHOTO_KINDS
from mgf_engine.stages import STAGE_NAMES
from tests.support.jobs import finish_all, redone


def test_which_photos_are_clicked_decides_the_scene_only_where_photos_are_left_out(tmp_path, source) -> None:
    prompts = tmp_path / "prompts.json"
    for name in ("b", "c", "d"):
        (source / "images" / f"{name}.jpg").write_bytes(b"x")
    keys = {}
    for limit in (0, 3):
        for text in ('{"a": {"positive": [[1, 2]]}}', '{"a": {"positive": [[3, 4]]}}', '{"b": {"positive": [[3, 4]]}}'):
            prompts.write_text(text)
            given = {"max_photos": limit}
            with Job.start(tmp_path / "job", source, prompts, user_options=given, resume=True) as job:
                keys[limit, text] = job.keys["scene"]
    all_photos, few_photos = list(keys.values())[:3], list(keys.values())[3:]
    assert len(set(all_photos)) == 1
    assert few_photos[0] == few_photos[1] != few_photos[2]


@pytest.mark.parametrize("name", [*(f"images/b{kind}" for kind in sorted(PHOTO_KINDS)), "images/a.jpg"])
def test_changed_photos_redo_everything(tmp_path: Path, source: Path, name: str) -> None:
    assert redone(tmp_path / "job", lambda: (source / name).write_bytes(b"zz"), source) == list(STAGE_NAMES)


@pytest.mark.parametrize("name", ["cameras.txt", "points3D.txt", "rigs.txt", "images/a.jpg"])
def test_changed_models_redo_everything(tmp_path: Path, model: Path, name: str) -> None:
    assert redone(tmp_path / "job", lambda: (model / name).write_text("# of today\n"), model) == list(STAGE_NAMES)


NOT_READ = ["notes.txt", "images/notes.json", "images/b.jpg", "mgf_job.prompts.json", "database.db", "old/cameras.txt"]


@pytest.mark.parametrize("name", [*NOT_READ, "other/job.json"])
def test_files_that_no_stage_reads_change_nothing(tmp_path: Path, model: Path, name: str) -> None:
    (model / name).parent.mkdir(exist_ok=True)
    (model / "other").mkdir(exist_ok=True)

    def change() -> None:
        (model / name).write_text("{}")
        (model / "other" / "a.png").write_bytes(b"of another job")

    assert redone(tmp_path / "job", change, model) == []


def test_a_second_job_in_a_folder_of_photos_is_not_among_them(source: Path) -> None:
    def second() -> None:
        with Job.start(source / "images" / "second", source) as job:
            (job.path("renders")).mkdir()
            job.path("renders", "a.png").write_bytes(b"no photo")
            job.path("texture.jpg").write_bytes(b"no photo")

    assert redone(source / "images" / "first", second, source) == []


@pytest.mark.parametrize("change", ["more", "fewer bytes"])
def test_changed_clicks_redo_the_masks_and_all_after(tmp_path: Path, model: Path, change: str) -> None:
    clicks = model / "clicks.json"
    clicks.write_text('{"a.jpg": {"positive": [[1, 2]]}}')
    text = '{"a.jpg": {"positive": [[1, 2], [2, 3]]}}' if change == "more" else "{}"
    assert redone(tmp_path / "job", lambda: clicks.write_text(text), model, clicks) == list(STAGE_NAMES[1:])


@pytest.mark.parametrize(("name", "again"), [("a.png", list(STAGE_NAMES[1:])), ("notes.txt", []), ("b.png", [])])
def test_only_masks_of_photos_are_watched(tmp_path: Path, model: Path, name: str, again: list[str]) -> None:
    folder = tmp_path / "own masks"
    folder.mkdir()
    assert redone(tmp_path / "job", lambda: (folder / name).write_bytes(b"1"), model, None, folder) == again


def test_a_job_folder_inside_the_scene_does_not_change_the_scene(source: Path) -> None:
    with Job.start(source / "out", source) as job:
        before = job.keys
        (source / "out" / "picture.png").write_bytes(b"1")
    with Job.start(source / "out", resume=True) as job:
        assert job.keys == before


def test_a_relative_job_folder_inside_the_scene_does_not_change_the_scene(source: Path, monkeypatch) -> None:
    monkeypatch.chdir(source.parent)
    with Job.start(Path(source.name) / "job", Path(source.name)) as job:
        before = job.keys
        job.path("picture.png").write_bytes(b"of the job")
    with Job.start(Path(source.name) / "job", resume=True) as job:
        assert job.keys == before


def test_a_photo_that_is_gone_is_named_and_nothing_is_lost(tmp_path: Path, model: Path) -> None:
    with Job.start(tmp_path / "job", model) as job:
        finish_all(job)
    photo = (model / "images" / "a.jpg").rename(tmp_path / "elsewhere.jpg")
    with pytest.raises(BadInput, match=r"a\.jpg"):
        Job.start(tmp_path / "job", resume=True)
    photo.rename(model / "images" / "a.jpg")
    with Job.start(tmp_path / "job", resume=True) as job:
        assert all(job.done(stage) for stage in STAGE_NAMES)


def test_photos_on_a_disk_that_is_not_there_cost_no_stage(tmp_path: Path, model: Path) -> None:
    """Three of seven are enough to go on with, but by far too few: the job would be made anew and then be refused."""
    names = [f"{k}.jpg" for k in range(7)]
    images = "".join(f"{k} 1 0 0 0 0 0 0 1 {name}\n\n" for k, name in enumerate(names, 1))
    (model / "images.txt").write_text(images)
    for name in names:
        (model / "images" / name).write_bytes(b"x")
    with Job.start(tmp_path / "job", model) as job:
        finish_all(job)
    away = tmp_path / "away" / "disk"
    away.mkdir(parents=True)
    for name in names[:4]:
        (model / "images" / name).rename(away / name)
    with pytest.raises(BadInput, match=r"4 of 7 photos .*'0\.jpg'"):
        Job.start(tmp_path / "job", resume=True)
    for name in names[:4]:
        (away / name).rename(model / "images" / name)
    with Job.start(tmp_path / "job", resume=True) as job:
        assert all(job.done(stage) for stage in STAGE_NAMES)
