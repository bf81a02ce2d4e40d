# SPDX-License-Identifier: GPL-3.0-or-later
"""What a job does again after a change of options, inputs or results, and what it keeps."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mgf_engine.errors import BadInput
from mgf_engine.geometry.block_store import BlockStore
from mgf_engine.jobs.job import Job
from mgf_engine.jobs.results import load_field, load_mesh, load_scene_of
from mgf_engine.jobs.runs import keep_run
from mgf_engine.scene.colmap import PHOTO_KINDS
from mgf_engine.stages import STAGE_NAMES, stage_named
from mgf_engine.system import memory
from tests.support.jobs import finish_all, write_photo_folder


@pytest.fixture
def source(tmp_path: Path) -> Path:
    return write_photo_folder(tmp_path / "scene Ω")


@pytest.fixture
def model(source: Path) -> Path:
    """The source with a model that names its photo."""
    names = {"cameras": "1 PINHOLE 4 4 1 1 2 2\n", "images": "1 1 0 0 0 0 0 0 1 a.jpg\n\n", "points3D": ""}
    for name, text in names.items():
        (source / f"{name}.txt").write_text(text)
    return source


def test_a_finished_job_is_done_after_reopening(tmp_path: Path, source: Path) -> None:
    with Job.start(tmp_path / "job", source) as job:
        assert not any(job.done(stage) for stage in STAGE_NAMES)
        finish_all(job)
    with Job.start(tmp_path / "job", resume=True) as job:
        assert all(job.done(stage) for stage in STAGE_NAMES)


@pytest.mark.parametrize(
    ("options", "first_redone"),
    [({"resolution": 100}, "scene"), ({"vote_dilation": 1}, "masks"), ({"boundary_loss": True}, "masks"),
     ({"seed": 5}, "field"), ({"holdout_every": 0}, "field"), ({"level_steps": 3}, "mesh"),
     ({"render_all": True}, "deliver")],
)  # fmt: skip
def test_a_changed_option_redoes_its_stage_and_the_later_ones(tmp_path, source, options, first_redone) -> None:
    with Job.start(tmp_path / "job", source) as job:
        finish_all(job)
    with Job.start(tmp_path / "job", source, user_options=options, resume=True) as job:
        assert [s for s in STAGE_NAMES if not job.done(s)] == list(STAGE_NAMES[STAGE_NAMES.index(first_redone) :])


def test_options_given_once_stay_for_the_resumed_job(tmp_path: Path, source: Path) -> None:
    Job.start(tmp_path / "job", source, user_options={"iterations": 11}).close()
    with Job.start(tmp_path / "job", source, user_options={"seed": 2}, resume=True) as job:
        assert (job.config.iterations, job.config.seed) == (11, 2)


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


def redone(folder: Path, change: Callable[[], object], *inputs: Path | None) -> list[str]:
    """Stages that a change of the inputs makes run again, of a job that was finished before."""
    with Job.start(folder, *inputs, resume=True) as job:
        finish_all(job)
        change()
        assert all(job.done(stage) for stage in STAGE_NAMES)  # the run that is open ends as it began
    with Job.start(folder, resume=True) as job:
        return [stage for stage in STAGE_NAMES if not job.done(stage)]


def test_a_limit_that_leaves_no_photo_out_changes_nothing(tmp_path: Path, source: Path) -> None:
    with Job.start(tmp_path / "job", source, user_options={"preset": "standard"}) as job:
        keys = job.keys
    with Job.start(tmp_path / "job", user_options={"preset": "draft"}, resume=True) as job:
        assert [stage for stage in STAGE_NAMES if job.keys[stage] == keys[stage]] == ["scene", "masks"]


@pytest.mark.parametrize(("adjust", "first"), [(False, "deliver"), (True, "scene")])
def test_numbers_of_georeferencing_redo_the_scene_only_where_control_points_move_cameras(
    tmp_path: Path, source: Path, adjust: bool, first: str
) -> None:
    (tmp_path / "points.csv").write_text("P1,1,2,3")
    given = {"control": str(tmp_path / "points.csv"), "control_adjust": adjust}
    with Job.start(tmp_path / "job", source, user_options=given) as job:
        finish_all(job)
    with Job.start(tmp_path / "job", user_options={"control_points.accuracy": 0.02}, resume=True) as job:
        undone = [stage for stage in STAGE_NAMES if not job.done(stage)]
    assert undone == list(STAGE_NAMES[STAGE_NAMES.index(first) :])


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


def test_beginning_a_stage_removes_results_of_other_options_only(tmp_path: Path, source: Path) -> None:
    with Job.start(tmp_path / "job", source) as job:
        job.begin("field")
        checkpoint = job.path("checkpoints", "training.npz")
        checkpoint.parent.mkdir()
        checkpoint.write_bytes(b"1")
        job.begin("field")
        assert checkpoint.exists()
    with Job.start(tmp_path / "job", user_options={"seed": 3}, resume=True) as job:
        job.begin("field")
        assert not checkpoint.exists()


@pytest.mark.parametrize(
    ("stage", "kind", "options"), [("field", "start", {"start_cut.area": 0.5}), ("mesh", "mesh", {"level_steps": 3})]
)
def test_finished_blocks_of_an_interrupted_stage_are_for_the_same_options_only(
    tmp_path: Path, source: Path, monkeypatch, stage: str, kind: str, options: dict
) -> None:
    monkeypatch.setattr(memory, "_scratch", tmp_path / "job")
    points = np.zeros((1, 3))  # the same with both options
    with Job.start(tmp_path / "job", source) as job:
        job.begin(stage)
        BlockStore(kind, points).save(1, vertices=points)
        job.begin(stage)
        assert BlockStore(kind, points).load(1) is not None
    with Job.start(tmp_path / "job", user_options=options, resume=True) as job:
        job.begin(stage)
        assert BlockStore(kind, points).load(1) is None


def leave_results(job: Job) -> None:
    for stage in STAGE_NAMES:
        for name in (*stage_named(stage).required_outputs, *stage_named(stage).optional_outputs.get("texture", ())):
            job.path(name).parent.mkdir(parents=True, exist_ok=True)
            job.path(name).write_bytes(b"{}")


@pytest.mark.parametrize(
    ("deleted", "options", "lost"),
    [
        ([], {}, set()),
        (["mesh.ply"], {}, {"mesh"}),
        (["report.html"], {}, {"deliver"}),
        (["texture.jpg"], {}, {"deliver"}),
        (["scene/scene.npz", "masks/scores.json", "checkpoints/field.npz"], {}, set()),  # nobody reads them any more
        (["checkpoints/field.npz"], {"level_steps": 3}, {"field"}),
        (["masks/scores.json"], {"render_all": True}, {"masks"}),
        (["mesh.ply", "masks/scores.json"], {}, {"mesh", "masks"}),
    ],
)
def test_results_that_are_gone_are_missed_where_they_are_needed(tmp_path, source, deleted, options, lost) -> None:
    with Job.start(tmp_path / "job", source) as job:
        finish_all(job)
        leave_results(job)
        for name in deleted:
            job.path(name).unlink()
    with Job.start(tmp_path / "job", user_options=options, resume=True) as job:
        assert job.missing_results("deliver") == lost


def test_a_result_whose_run_was_deleted_by_hand_is_made_again(tmp_path: Path, source: Path) -> None:
    with Job.start(tmp_path / "job", source) as job:
        finish_all(job)
        leave_results(job)
        keep_run(job.folder, ["mesh.ply"], {"views": [], "mesh": "mesh.ply", "figures": {}}, {})
        assert job.missing_results("deliver") == set()
        shutil.rmtree(job.path("runs"))
        assert job.missing_results("deliver") == {"deliver"}


@pytest.mark.parametrize("stage", STAGE_NAMES)
def test_the_stage_that_is_asked_for_is_missed_in_any_case(tmp_path: Path, source: Path, stage: str) -> None:
    with Job.start(tmp_path / "job", source) as job:
        finish_all(job)
        leave_results(job)
        job.path(stage_named(stage).required_outputs[0]).unlink()
        assert job.missing_results(stage) == {stage}


@pytest.mark.parametrize(("stage", "load"), [("scene", load_scene_of), ("field", load_field), ("mesh", load_mesh)])
def test_a_result_that_cannot_be_read_is_made_again_alone(tmp_path: Path, source: Path, stage: str, load) -> None:
    with Job.start(tmp_path / "job", source) as job:
        finish_all(job)
        leave_results(job)
        with pytest.raises(BadInput, match="again"):
            load(job)
        assert [name for name in STAGE_NAMES if not job.done(name)] == [stage]


def test_a_stage_done_again_with_the_same_options_keeps_the_later_ones(tmp_path: Path, source: Path) -> None:
    with Job.start(tmp_path / "job", source) as job:
        finish_all(job)
        job.finish("masks", job.begin("masks"), 1.0, 2.0, 1, {}, [])
        assert all(job.done(stage) for stage in STAGE_NAMES)
        job.forget("masks")
        assert [stage for stage in STAGE_NAMES if not job.done(stage)] == ["masks"]


def test_marks_of_begun_stages_may_hold_anything(tmp_path: Path, source: Path) -> None:
    with Job.start(tmp_path / "job", source) as job:
        job.path(".started-mesh").write_bytes(b"\xff\xfe")
        job.path("mesh.ply").write_bytes(b"of other options")
        job.begin("mesh")
        assert not job.path("mesh.ply").exists()


def test_job_file_holds_inputs_and_options(tmp_path: Path, source: Path) -> None:
    Job.start(tmp_path / "job", source, user_options={"seed": 4}).close()
    data = json.loads((tmp_path / "job" / "job.json").read_text())
    assert data["given"] == {"seed": 4}
    assert data["config"]["seed"] == 4
    assert data["source"] == str(source.resolve())
