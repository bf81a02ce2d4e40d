# SPDX-License-Identifier: GPL-3.0-or-later
"""What a job is started from, and the folder it gets."""

from __future__ import annotations

import json
import os
from pathlib import Path

import bpy
import pytest
import synthetic
from jobs import arguments

from mgf_blender.common import runner
from mgf_blender.common.job import Job
from mgf_blender.reconstruct.start import make_job
from mgf_blender.scene_import.imported_scene import ImportedScene


def test_photos_alone_start_structure_from_motion(addon, engine, house):
    engine("ok", FAKE_MODEL=house.model)
    folder = house.folder / "images"
    with pytest.raises(RuntimeError, match="holds no photos"):
        bpy.ops.mgf.import_photos(directory=str(house.model))
    addon.job_folder = ""
    assert bpy.ops.mgf.import_photos(directory=str(folder)) == {"FINISHED"}
    assert arguments(addon.job_folder)[:2] == ["scene", str(folder)]
    assert len(ImportedScene.find(bpy.context.scene).objects("Cameras")) == 12 and addon.source == str(folder)
    assert all(p.file for p in addon.photos)
    assert ImportedScene.find(bpy.context.scene).collection.name == house.folder.name  # "model" is the engine's folder


def test_photos_in_hidden_folders_alone_are_none(addon, engine, tmp_path):
    """The engine does not look there: the job began, and failed."""
    (tmp_path / ".thumbnails").mkdir()
    (tmp_path / ".thumbnails" / "a.JPG").write_bytes(b"x")
    with pytest.raises(RuntimeError, match="holds no photos"):
        bpy.ops.mgf.import_photos(directory=str(tmp_path))
    assert not addon.source


def test_photos_without_an_engine_leave_the_scene_alone(addon, house, monkeypatch):
    """The panel offered to reconstruct what had not been imported."""
    monkeypatch.setenv("MGF_ENGINE_PYTHON", str(house.folder / "no engine"))
    with pytest.raises(RuntimeError, match="There is no Python"):
        bpy.ops.mgf.import_photos(directory=str(house.folder / "images"))
    assert not addon.source and not addon.job_folder


def test_other_photos_are_found_in_their_own_folder(addon, engine, house, tmp_path):
    """They were searched where the first ones lay."""
    engine("ok", FAKE_MODEL=house.model)
    bpy.ops.mgf.import_photos(directory=str(house.folder / "images"))
    other = synthetic.write_house(tmp_path / "other", prefix="DSC")
    engine("ok", FAKE_MODEL=other.model)
    bpy.ops.mgf.import_photos(directory=str(other.folder / "images"))
    assert addon.photos and all(Path(photo.file).is_relative_to(other.folder) for photo in addon.photos)
    assert Path(addon.job_folder).is_relative_to(other.folder)


def test_a_folder_of_photos_that_may_not_be_read_is_named(addon, tmp_path, monkeypatch):
    def walk(folder, onerror):
        onerror(PermissionError(13, "Permission denied", str(tmp_path / "locked")))
        return iter(())

    monkeypatch.setattr(os, "walk", walk)
    with pytest.raises(RuntimeError, match=r"No permission for '.*locked'"):
        bpy.ops.mgf.import_photos(directory=str(tmp_path))
    assert not addon.source


def test_photos_with_a_model_are_imported_with_its_cameras(addon, engine, house):
    """The engine takes that model, so it finds no cameras: the import failed after the job."""
    engine("ok")
    assert bpy.ops.mgf.import_photos(directory=str(house.folder)) == {"FINISHED"}
    assert len(ImportedScene.find(bpy.context.scene).objects("Cameras")) == 12 and addon.source == str(house.folder)
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
        assert "--resume" not in arguments(state.job_folder) and state.job_folder
        bpy.ops.mgf.reconstruct()  # the same file goes on in its own folder
        assert "--resume" in arguments(state.job_folder)
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
