# SPDX-License-Identifier: GPL-3.0-or-later
"""A job belongs to the scene it was started in, whatever happens to scenes and objects meanwhile."""

from __future__ import annotations

import shutil
import time

import bpy
import pytest
from jobs import pump_until

from mgf_blender.common import runner
from mgf_blender.common.job import DONE
from mgf_blender.jobs import import_status
from mgf_blender.operator_calls import run_in
from mgf_blender.reconstruct import start
from mgf_blender.reconstruct.start import make_job
from mgf_blender.results import async_import
from mgf_blender.scene_import.imported_scene import ImportedScene
from mgf_blender.scene_keys import key_of, scene_key, scene_of


def test_objects_deleted_while_the_job_runs(ready, engine, house):
    engine("slow", FAKE_RESULT=house.job)
    job = make_job(bpy.context.scene)
    runner.submit(job)
    pump_until(lambda: job.stage == "scene")
    for obj in list(bpy.data.objects):
        bpy.data.objects.remove(obj)
    pump_until(lambda: not job.live)
    assert job.status == DONE and not job.warnings[1:]
    assert len(ImportedScene.find(bpy.context.scene).objects("Mesh")) == 1


def test_scene_deleted_while_the_job_runs(ready, engine, house):
    engine("slow", FAKE_RESULT=house.job)
    job = make_job(bpy.context.scene)
    runner.submit(job)
    pump_until(lambda: job.stage == "scene")
    bpy.ops.wm.read_homefile(use_empty=True)
    assert scene_of(job.scene_key) is None
    pump_until(lambda: not job.live)
    assert job.status == DONE and len(bpy.data.meshes) == 0


@pytest.mark.parametrize("window", [False, True])
def test_result_comes_from_the_job_s_folder(ready, engine, house, monkeypatch, window):
    """The field may name the next job's folder by then; what lies there belongs to another building."""
    monkeypatch.setattr(start, "in_background", lambda: not window)
    engine("slow", FAKE_RESULT=house.job)
    job = make_job(bpy.context.scene)
    runner.submit(job)
    pump_until(lambda: job.stage == "scene")
    ready.job_folder = str(house.folder.parent / "next")
    pump_until(lambda: not job.live)
    while async_import.pump():
        time.sleep(0.002)
    assert job.status == DONE and not job.warnings[1:] and not import_status.problem(bpy.context.scene)
    assert len(ImportedScene.find(bpy.context.scene).objects("Mesh")) == 1
    assert ready.job_folder == str(house.folder.parent / "next")
    with pytest.raises(RuntimeError, match=r"The job has no gone\.txt yet"):
        bpy.ops.mgf.open_job_file(name="gone.txt", directory=str(job.folder))


def test_found_cameras_come_from_the_job_s_folder(ready, engine, house):
    engine("slow")
    job = make_job(bpy.context.scene, "scene")
    model = job.folder / "scene" / "sfm" / "model"
    shutil.copytree(house.model, model)
    runner.submit(job)
    pump_until(lambda: job.stage == "scene")
    ready.job_folder = str(house.folder.parent / "next")
    bpy.data.objects.remove(ImportedScene.find(bpy.context.scene).objects("Cameras")[0])
    pump_until(lambda: not job.live)
    assert not job.warnings[1:] and len(ImportedScene.find(bpy.context.scene).objects("Cameras")) == 12


def test_two_scenes_keep_to_themselves(ready, engine, house):
    first = bpy.context.scene
    make_job(first)  # gives the first scene its key
    bpy.ops.scene.new(type="FULL_COPY")
    second = bpy.context.scene
    assert second != first
    second.mgf.job_folder = str(house.folder.parent / "second job")
    assert not ImportedScene.find(first).objects("Mesh") and not ImportedScene.find(second).objects("Mesh")
    bpy.ops.mgf.reconstruct()
    assert first.mgf.key != second.mgf.key
    assert len(ImportedScene.find(second).objects("Mesh")) == 1 and not ImportedScene.find(first).objects("Mesh")


def test_a_result_for_a_scene_that_is_not_shown_leaves_the_view_of_the_other_alone(ready, house):
    """It turned to where the mesh would be, and drew the points there in another light."""
    first = bpy.context.scene
    bpy.ops.scene.new(type="NEW")
    (space,) = [area.spaces.active for area in bpy.context.screen.areas if area.type == "VIEW_3D"]
    space.shading.light = "FLAT"
    view = space.region_3d
    before = tuple(view.view_location), view.view_distance, space.shading.color_type, space.shading.light
    assert not run_in(first, "import_result", directory=str(house.job))
    assert ImportedScene.find(first).objects("Mesh")
    after = tuple(view.view_location), view.view_distance, space.shading.color_type, space.shading.light
    assert after == before


def test_a_copied_scene_and_the_job_of_the_first(ready, engine, house):
    """The copy holds the same properties; the job and its mesh stay with the scene that started it."""
    engine("slow", FAKE_RESULT=house.job)
    first = bpy.context.scene
    first.name = "Z"  # behind the copy in the list
    job = make_job(first)
    runner.submit(job)
    pump_until(lambda: job.stage == "scene")
    bpy.ops.scene.new(type="FULL_COPY")
    second = bpy.context.scene
    second.name = "A"
    assert runner.last_job(key_of(first)) is job and runner.last_job(key_of(second)) is None
    assert scene_key(second) != job.scene_key and scene_key(first) == job.scene_key
    assert scene_of(job.scene_key) == first
    pump_until(lambda: not job.live)
    assert len(ImportedScene.find(first).objects("Mesh")) == 1 and not ImportedScene.find(second).objects("Mesh")


def test_a_job_whose_start_was_undone_is_still_the_scene_s(ready, engine, house):
    """Undo takes the scene's key away, which the start of the job had made."""
    engine("slow", FAKE_RESULT=house.job)
    bpy.ops.ed.undo_push(message="before")
    assert not ready.key
    job = make_job(bpy.context.scene)
    runner.submit(job)
    pump_until(lambda: job.stage == "scene")
    bpy.ops.ed.undo_push(message="start")
    bpy.ops.ed.undo()
    scene = bpy.context.scene
    assert not scene.mgf.key and runner.last_job(key_of(scene)) is job and scene_of(job.scene_key) == scene
    pump_until(lambda: not job.live)
    assert len(ImportedScene.find(scene).objects("Mesh")) == 1 and scene_key(scene) == job.scene_key
