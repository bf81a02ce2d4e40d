# SPDX-License-Identifier: GPL-3.0-or-later
"""From the button to the mesh, and everything that can go wrong between."""

from __future__ import annotations

import json
import shutil
import time
from pathlib import Path

import bpy
import numpy as np
import pytest
import synthetic
from layouts import draw

from mgf_blender.common import runner
from mgf_blender.common.errors import UserError
from mgf_blender.common.job import CANCELLED, DONE, FAILED, Job
from mgf_blender.properties import scene_key, scene_of
from mgf_blender.reconstruct import preview_image, start
from mgf_blender.reconstruct.operators import interrupted, last_job
from mgf_blender.reconstruct.panel import MGF_PT_reconstruct
from mgf_blender.reconstruct.start import make_job
from mgf_blender.results import async_import
from mgf_blender.scene_import.tree import Tree


@pytest.fixture
def ready(addon, engine, house):
    """An imported house with one click, and an engine whose result is the finished job."""
    engine("ok", FAKE_RESULT=house.job)
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    addon.job_folder = str(house.folder.parent / "new job")
    click = addon.photos[0].clicks.add()
    click.uv = (100.5, 80.25)
    return addon


def pump(until, seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not until() and time.monotonic() < end:
        runner.pump()
        time.sleep(0.01)
    assert until()


def arguments(state) -> list[str]:
    return json.loads(Path(state.job_folder, "arguments.json").read_text())


def test_button_to_mesh(ready, house):
    assert bpy.ops.mgf.reconstruct() == {"FINISHED"}
    tree = Tree.find(bpy.context.scene)
    assert [len(tree.objects(k)) for k in ("Cameras", "Points", "Mesh", "Renders")] == [12, 1, 1, 4]
    assert json.loads(ready.figures)["psnr"] == 27.5
    job = runner.jobs(ready.key)[-1]
    assert job.status == DONE
    line = arguments(ready)
    assert line[:2] == ["reconstruct", str(house.folder)] and "preset=standard" in line and "--resume" not in line
    prompts = json.loads(Path(line[line.index("--prompts") + 1]).read_text())
    assert prompts == {ready.photos[0].name: {"positive": [[100.5, 80.25]]}}


def test_crop_box_reaches_the_engine_and_leaves_with_the_object(ready):
    bpy.ops.mgf.add_crop_box()
    bpy.ops.mgf.reconstruct()
    given = next(a for a in arguments(ready) if a.startswith("crop_box="))
    assert len(given.removeprefix("crop_box=").split()) == 16
    bpy.ops.mgf.remove_crop_box()
    bpy.ops.mgf.reconstruct()
    assert "crop_box=" in arguments(ready)  # empty, so that the resumed job forgets it


def test_the_papers_preset_is_handed_over_as_one_word(ready):
    """What it changes, options of algorithms too, is the engine's own knowledge."""
    ready.options.preset = "paper"
    assert (ready.options.surface, ready.options.iterations, ready.options.match_photos) == ("opacity", 7000, False)
    bpy.ops.mgf.reconstruct()
    line = arguments(ready)
    assert [line[i + 1] for i, word in enumerate(line) if word == "--set"] == ["preset=paper"]


def test_second_run_resumes_in_its_folder(ready):
    bpy.ops.mgf.reconstruct()
    bpy.ops.mgf.reconstruct()
    assert "--resume" in arguments(ready)
    assert len(Tree.find(bpy.context.scene).objects("Mesh")) == 1


def test_option_set_back_to_default_reaches_a_resumed_job(ready):
    ready.options.resolution = 600
    bpy.ops.mgf.reconstruct()
    ready.options.resolution = 750
    bpy.ops.mgf.reconstruct()
    assert "resolution=750" in arguments(ready)


@pytest.mark.parametrize(
    ("prepare", "words"),
    [
        (lambda s: s.photos[0].clicks.clear(), "Mark the building in one photo or more first"),
        (lambda s: setattr(s, "source", ""), "Import a COLMAP scene or photos first"),
    ],
)
def test_what_is_missing_is_said(ready, prepare, words):
    prepare(ready)
    with pytest.raises(RuntimeError, match=words):
        bpy.ops.mgf.reconstruct()
    assert runner.jobs() == []


def test_no_engine(ready, monkeypatch, tmp_path):
    monkeypatch.setenv("MGF_ENGINE_PYTHON", str(tmp_path / "gone"))
    with pytest.raises(RuntimeError, match="There is no Python in"):
        bpy.ops.mgf.reconstruct()
    monkeypatch.delenv("MGF_ENGINE_PYTHON")
    with pytest.raises(RuntimeError, match="The engine is not installed; press Install Engine"):
        bpy.ops.mgf.reconstruct()


@pytest.mark.parametrize(
    ("mode", "words"),
    [
        ("bad", "no photos"),
        ("full", "The disk of "),
        ("silent", "code 77 .Segmentation fault in kernel.; press Resume"),
    ],
)
def test_failures_reach_the_operator(ready, engine, mode, words):
    engine(mode)
    with pytest.raises(RuntimeError, match=words):
        bpy.ops.mgf.reconstruct()
    assert runner.jobs()[-1].status == FAILED
    assert not Tree.find(bpy.context.scene).objects("Mesh")


def test_queue_runs_one_after_the_other(ready, engine):
    engine("slow")
    jobs = []
    for i in range(3):
        ready.job_folder = ready.job_folder + str(i)
        jobs.append(make_job(bpy.context.scene))
        runner.submit(jobs[-1])
    with pytest.raises(UserError, match="already runs in this folder"):
        runner.submit(make_job(bpy.context.scene))
    runner.pump()
    assert [j.status for j in jobs] == ["RUNNING", "QUEUED", "QUEUED"]
    jobs[1].cancel()
    pump(lambda: jobs[0].stage == "scene")
    jobs[0].cancel()
    pump(lambda: jobs[2].status == "RUNNING")
    assert [j.status for j in jobs[:2]] == [CANCELLED, CANCELLED]


def test_objects_deleted_while_the_job_runs(ready, engine, house):
    engine("slow", FAKE_RESULT=house.job)
    job = make_job(bpy.context.scene)
    runner.submit(job)
    pump(lambda: job.stage == "scene")
    for obj in list(bpy.data.objects):
        bpy.data.objects.remove(obj)
    pump(lambda: not job.live)
    assert job.status == DONE and not job.warnings[1:]
    assert len(Tree.find(bpy.context.scene).objects("Mesh")) == 1


def test_scene_deleted_while_the_job_runs(ready, engine, house):
    engine("slow", FAKE_RESULT=house.job)
    job = make_job(bpy.context.scene)
    runner.submit(job)
    pump(lambda: job.stage == "scene")
    bpy.ops.wm.read_homefile(use_empty=True)
    assert scene_of(job.scene_key) is None
    pump(lambda: not job.live)
    assert job.status == DONE and len(bpy.data.meshes) == 0


@pytest.mark.parametrize("window", [False, True])
def test_result_comes_from_the_job_s_folder(ready, engine, house, monkeypatch, window):
    """The field may name the next job's folder by then; what lies there belongs to another building."""
    monkeypatch.setattr(start, "in_background", lambda: not window)
    engine("slow", FAKE_RESULT=house.job)
    job = make_job(bpy.context.scene)
    runner.submit(job)
    pump(lambda: job.stage == "scene")
    ready.job_folder = str(house.folder.parent / "next")
    pump(lambda: not job.live)
    while async_import.pump():
        time.sleep(0.002)
    assert job.status == DONE and not job.warnings[1:] and not async_import.problem(bpy.context.scene)
    assert len(Tree.find(bpy.context.scene).objects("Mesh")) == 1
    assert ready.job_folder == str(house.folder.parent / "next")
    with pytest.raises(RuntimeError, match=r"The job has no gone\.txt yet"):
        bpy.ops.mgf.open_job_file(name="gone.txt", directory=str(job.folder))


def test_found_cameras_come_from_the_job_s_folder(ready, engine, house):
    engine("slow")
    job = make_job(bpy.context.scene, "scene")
    model = job.folder / "scene" / "sfm" / "model"
    shutil.copytree(house.model, model)
    runner.submit(job)
    pump(lambda: job.stage == "scene")
    ready.job_folder = str(house.folder.parent / "next")
    bpy.data.objects.remove(Tree.find(bpy.context.scene).objects("Cameras")[0])
    pump(lambda: not job.live)
    assert not job.warnings[1:] and len(Tree.find(bpy.context.scene).objects("Cameras")) == 12


def test_two_scenes_keep_to_themselves(ready, engine, house):
    first = bpy.context.scene
    make_job(first)  # gives the first scene its key
    bpy.ops.scene.new(type="FULL_COPY")
    second = bpy.context.scene
    assert second != first
    second.mgf.job_folder = str(house.folder.parent / "second job")
    assert not Tree.find(first).objects("Mesh") and not Tree.find(second).objects("Mesh")
    bpy.ops.mgf.reconstruct()
    assert first.mgf.key != second.mgf.key
    assert len(Tree.find(second).objects("Mesh")) == 1 and not Tree.find(first).objects("Mesh")


def test_a_copied_scene_and_the_job_of_the_first(ready, engine, house):
    """The copy holds the same properties; the job and its mesh stay with the scene that started it."""
    engine("slow", FAKE_RESULT=house.job)
    first = bpy.context.scene
    first.name = "Z"  # behind the copy in the list
    job = make_job(first)
    runner.submit(job)
    pump(lambda: job.stage == "scene")
    bpy.ops.scene.new(type="FULL_COPY")
    second = bpy.context.scene
    second.name = "A"
    assert last_job(first) is job and last_job(second) is None
    assert scene_key(second) != job.scene_key and scene_key(first) == job.scene_key
    assert scene_of(job.scene_key) == first
    pump(lambda: not job.live)
    assert len(Tree.find(first).objects("Mesh")) == 1 and not Tree.find(second).objects("Mesh")


def test_a_job_whose_start_was_undone_is_still_the_scene_s(ready, engine, house):
    """Undo takes the scene's key away, which the start of the job had made."""
    engine("slow", FAKE_RESULT=house.job)
    bpy.ops.ed.undo_push(message="before")
    assert not ready.key
    job = make_job(bpy.context.scene)
    runner.submit(job)
    pump(lambda: job.stage == "scene")
    bpy.ops.ed.undo_push(message="start")
    bpy.ops.ed.undo()
    scene = bpy.context.scene
    assert not scene.mgf.key and last_job(scene) is job and scene_of(job.scene_key) == scene
    pump(lambda: not job.live)
    assert len(Tree.find(scene).objects("Mesh")) == 1 and scene_key(scene) == job.scene_key


def quit_during(stage, engine, tmp_path) -> None:
    """Starts a job, saves the file, leaves Blender in this stage and opens the file again."""
    engine("slow")
    job = make_job(bpy.context.scene)
    runner.submit(job)
    pump(lambda: job.stage == stage)
    path = str(tmp_path / "saved.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    runner.stop_all()
    bpy.ops.wm.open_mainfile(filepath=path)


def test_quit_and_reopen_finds_the_job(ready, engine, tmp_path):
    quit_during("scene", engine, tmp_path)
    scene = bpy.context.scene
    assert interrupted(scene)
    assert [tuple(c.uv) for c in scene.mgf.photos[0].clicks] == [(100.5, 80.25)]
    engine("ok")
    scene.mgf.import_when_done = False
    assert bpy.ops.mgf.resume() == {"FINISHED"}
    assert "--resume" in arguments(scene.mgf)


def test_quit_and_reopen_finds_a_second_run_that_was_interrupted(ready, engine, tmp_path):
    """The results of the first run are still in the folder."""
    ready.import_when_done = False
    bpy.ops.mgf.reconstruct()
    assert Path(ready.job_folder, "deliver.json").is_file() and not interrupted(bpy.context.scene)
    quit_during("masks", engine, tmp_path)
    assert interrupted(bpy.context.scene)


def test_what_was_to_end_after_an_early_stage_was_not_interrupted(ready):
    """Suggest and Import Photos stop after the scene stage, Find Masks after the masks."""
    job = Path(ready.job_folder)
    job.mkdir()
    record = {"source": ready.source, "given": {}, "stages": {"scene": {}, "masks": {}}}
    (job / "job.json").write_text(json.dumps(record))
    for name in ("scene", "masks"):
        (job / f".started-{name}").touch()
    assert not interrupted(bpy.context.scene) and "interrupted" not in draw(MGF_PT_reconstruct).said
    (job / ".started-field").touch()
    assert interrupted(bpy.context.scene) and "interrupted" in draw(MGF_PT_reconstruct).said


def test_resume_goes_on_with_the_options_of_the_job(ready, engine):
    """The engine keeps what it was given as text; other values would begin the job again from its first stage."""
    ready.options.preset, ready.options.resolution, ready.options.screening = "draft", 320, False
    ready.options.opacity_level = 0.25
    engine("silent")
    with pytest.raises(RuntimeError):
        bpy.ops.mgf.reconstruct()
    before = arguments(ready)
    ready.options.preset, ready.options.screening, ready.options.opacity_level = "standard", True, 0.5
    ready.options.level_steps = 5  # which the job was not given
    engine("ok")
    bpy.ops.mgf.resume()
    assert arguments(ready) == [*before, "--resume"]
    assert (ready.options.preset, ready.options.resolution, ready.options.screening) == ("draft", 320, False)


def test_resume_goes_on_with_the_command_that_ended_early(ready, engine):
    engine("silent")
    with pytest.raises(RuntimeError):
        bpy.ops.mgf.find_masks()
    engine("ok")
    bpy.ops.mgf.resume()
    assert arguments(ready)[0] == "masks" and "--resume" in arguments(ready)
    bpy.ops.mgf.reconstruct()
    bpy.ops.mgf.resume()  # from a script: the last job is done, so it is the whole way again
    assert arguments(ready)[0] == "reconstruct"


def test_import_of_a_result_is_one_undo_step(ready):
    ready.import_when_done = False
    bpy.ops.mgf.reconstruct()
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.mgf.import_result("EXEC_DEFAULT", True)
    assert len(Tree.find(bpy.context.scene).objects("Mesh")) == 1
    bpy.ops.ed.undo()
    tree = Tree.find(bpy.context.scene)
    assert len(tree.objects("Cameras")) == 12 and not tree.objects("Mesh") and not tree.objects("Renders")
    bpy.ops.ed.redo()
    assert len(Tree.find(bpy.context.scene).objects("Mesh")) == 1


def test_preview_follows_the_engine(ready, engine, house, tmp_path):
    from synthetic import write_png

    write_png(tmp_path / "p.png", np.full((4, 6, 3), 200, np.uint8))
    engine("ok", FAKE_RESULT=house.job, FAKE_PREVIEW=tmp_path / "p.png")
    bpy.ops.mgf.reconstruct()
    image = bpy.data.images[preview_image.NAME]
    assert tuple(image.size) == (6, 4) and abs(image.pixels[0] - 200 / 255) < 0.01
    write_png(tmp_path / "q.png", np.full((2, 2, 3), 10, np.uint8))
    preview_image.show(tmp_path / "q.png")
    assert tuple(image.size) == (2, 2) and preview_image.show(tmp_path / "gone.png") is None


def test_undo_does_not_blank_the_preview(ready, engine, house, tmp_path):
    """The picture came between two undo steps, so neither holds it."""
    synthetic.write_png(tmp_path / "p.png", np.full((4, 6, 3), 200, np.uint8))
    bpy.ops.ed.undo_push(message="one")
    ready.part = "door"
    bpy.ops.ed.undo_push(message="two")
    area = max(bpy.context.window.screen.areas, key=lambda a: a.width * a.height)
    area.type = "IMAGE_EDITOR"
    preview_image.show(tmp_path / "p.png")
    area.spaces.active.image = bpy.data.images[preview_image.NAME]
    for turn in (bpy.ops.ed.undo, bpy.ops.ed.redo):
        turn()
        image = area.spaces.active.image
        assert image is not None and image.name == preview_image.NAME and tuple(image.size) == (6, 4)
    synthetic.write_png(tmp_path / "q.png", np.full((2, 2, 3), 10, np.uint8))
    preview_image.show(tmp_path / "q.png")
    assert tuple(area.spaces.active.image.size) == (2, 2) and len([i for i in bpy.data.images if "MGF" in i.name]) == 1
    area.spaces.active.image = None
    bpy.ops.ed.undo()
    assert area.spaces.active.image is None


def test_broken_result_is_a_sentence_not_a_traceback(ready, engine, house):
    (house.job / "mesh.ply").write_bytes(b"ply\nend_header\n")
    bpy.ops.mgf.reconstruct()
    job = runner.jobs()[-1]
    assert job.status == DONE and "damaged" in job.warnings[-1]
    assert not Tree.find(bpy.context.scene).objects("Mesh")


def test_photos_alone_start_structure_from_motion(addon, engine, house):
    engine("ok", FAKE_MODEL=house.model)
    folder = house.folder / "images"
    with pytest.raises(RuntimeError, match="holds no photos"):
        bpy.ops.mgf.import_photos(directory=str(house.model))
    addon.job_folder = ""
    assert bpy.ops.mgf.import_photos(directory=str(folder)) == {"FINISHED"}
    assert arguments(addon)[:2] == ["scene", str(folder)]
    assert len(Tree.find(bpy.context.scene).objects("Cameras")) == 12 and addon.source == str(folder)
    assert all(p.file for p in addon.photos)
    assert Tree.find(bpy.context.scene).collection.name == house.folder.name  # "model" is the engine's folder


def test_photos_in_hidden_folders_alone_are_none(addon, engine, tmp_path):
    """The engine does not look there: the job began, and failed."""
    (tmp_path / ".thumbnails").mkdir()
    (tmp_path / ".thumbnails" / "a.JPG").write_bytes(b"x")
    with pytest.raises(RuntimeError, match="holds no photos"):
        bpy.ops.mgf.import_photos(directory=str(tmp_path))
    assert not addon.source


def test_photos_with_a_model_are_imported_with_its_cameras(addon, engine, house):
    """The engine takes that model, so it finds no cameras: the import failed after the job."""
    engine("ok")
    assert bpy.ops.mgf.import_photos(directory=str(house.folder)) == {"FINISHED"}
    assert len(Tree.find(bpy.context.scene).objects("Cameras")) == 12 and addon.source == str(house.folder)
    assert not runner.jobs()


def test_default_folder_of_an_unsaved_file_is_never_another_job_s(addon, engine, house):
    """A second session with the same photos and another building; the first building keeps its clicks and its mesh."""
    engine("ok", FAKE_RESULT=house.job)

    def session(count: int) -> str:
        bpy.ops.wm.read_homefile(use_empty=True)
        bpy.ops.mgf.import_colmap(filepath=str(house.folder))
        state = bpy.context.scene.mgf
        for i in range(count):
            state.photos[0].clicks.add().uv = (10.0 * i, 5.0)
        bpy.ops.mgf.reconstruct()
        assert "--resume" not in arguments(state) and state.job_folder
        bpy.ops.mgf.reconstruct()  # the same file goes on in its own folder
        assert "--resume" in arguments(state)
        return state.job_folder

    folders = [session(count) for count in (1, 2, 3)]
    assert [Path(f).name for f in folders] == ["mgf_job", "mgf_job_2", "mgf_job_3"]
    clicks = [json.loads(Path(f + ".prompts.json").read_text()) for f in folders]
    assert [len(next(iter(c.values()))["positive"]) for c in clicks] == [1, 2, 3]


def test_default_folder_survives_an_undo_and_is_no_other_scene_s(addon, engine, house):
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    bpy.ops.ed.undo_push(message="before")
    job = make_job_with_a_click(bpy.context.scene)
    job.folder.mkdir()
    (job.folder / "job.json").write_text("{}")
    bpy.ops.ed.undo_push(message="start")
    bpy.ops.ed.undo()
    assert not bpy.context.scene.mgf.job_folder and make_job_with_a_click(bpy.context.scene).folder == job.folder
    bpy.ops.scene.new(type="NEW")
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    assert make_job_with_a_click(bpy.context.scene).folder.name == "mgf_job_2"


def test_default_folder_lies_beside_a_saved_file(addon, engine, house, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "tower.blend"))
    for name in (house.folder.name, f"{house.folder.name}_2"):
        bpy.ops.mgf.import_colmap(filepath=str(house.folder))
        assert make_job_with_a_click(bpy.context.scene).folder == tmp_path / "tower_jobs" / name
        bpy.ops.scene.new(type="NEW")


def make_job_with_a_click(scene: bpy.types.Scene) -> Job:
    scene.mgf.photos[0].clicks.add().uv = (5.0, 5.0)
    return make_job(scene)


def test_masks_of_all_photos_are_a_job(ready):
    assert bpy.ops.mgf.find_masks() == {"FINISHED"}
    assert arguments(ready)[0] == "masks"


def test_panels_are_redrawn_when_there_is_news_and_not_otherwise(ready, engine, monkeypatch):
    engine("slow")
    drawn = []
    monkeypatch.setattr(runner, "redraw", lambda: drawn.append(runner.jobs()[-1].messages))
    runner.submit(make_job(bpy.context.scene))
    ticks, end = 0, time.monotonic() + 20
    while len(drawn) < 6 and time.monotonic() < end:
        assert runner._tick() == runner.TICK
        ticks += 1
        time.sleep(0.005)
    assert len(drawn) == 6 and drawn[0] == 0 and drawn[-1] > 0
    assert ticks > 2 * len(drawn)


def test_longest_tick_is_recorded(ready):
    bpy.ops.mgf.reconstruct()
    assert runner.longest_tick() > 0
