# SPDX-License-Identifier: GPL-3.0-or-later
"""From the button to the mesh, and everything that can go wrong between."""

from __future__ import annotations

import json
import time
from pathlib import Path

import bpy
import pytest
from jobs import arguments, pump_until

from mgf_blender.common import runner
from mgf_blender.common.errors import UserError
from mgf_blender.common.job import CANCELLED, DONE, FAILED
from mgf_blender.reconstruct.start import make_job
from mgf_blender.scene_import.imported_scene import ImportedScene


def test_button_to_mesh(ready, house):
    assert bpy.ops.mgf.reconstruct() == {"FINISHED"}
    imported = ImportedScene.find(bpy.context.scene)
    assert [len(imported.objects(k)) for k in ("Cameras", "Points", "Mesh", "Renders")] == [12, 1, 1, 4]
    assert json.loads(ready.figures)["psnr"] == 27.5
    job = runner.jobs(ready.key)[-1]
    assert job.status == DONE
    line = arguments(ready.job_folder)
    assert line[:2] == ["reconstruct", str(house.folder)] and "preset=standard" in line and "--resume" not in line
    prompts = json.loads(Path(line[line.index("--prompts") + 1]).read_text())
    assert prompts == {ready.photos[0].name: {"positive": [[100.5, 80.25]]}}


def test_crop_box_reaches_the_engine_and_leaves_with_the_object(ready):
    bpy.ops.mgf.add_crop_box()
    bpy.ops.mgf.reconstruct()
    given = next(a for a in arguments(ready.job_folder) if a.startswith("crop_box="))
    assert len(given.removeprefix("crop_box=").split()) == 16
    bpy.ops.mgf.remove_crop_box()
    bpy.ops.mgf.reconstruct()
    assert "crop_box=" in arguments(ready.job_folder)  # empty, so that the resumed job forgets it


def test_the_papers_preset_is_handed_over_as_one_word(ready):
    """What it changes, options of algorithms too, is the engine's own knowledge."""
    ready.options.preset = "paper"
    assert (ready.options.surface, ready.options.iterations, ready.options.match_photos) == ("opacity", 7000, False)
    bpy.ops.mgf.reconstruct()
    line = arguments(ready.job_folder)
    assert [line[i + 1] for i, word in enumerate(line) if word == "--set"] == ["preset=paper"]


@pytest.mark.parametrize(
    ("prepare", "words"),
    [
        (lambda s: s.photos[0].clicks.clear(), "Mark the building in one photo or more first"),
        (lambda s: setattr(s, "source", ""), "Import photos or a COLMAP scene first"),
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
    assert not ImportedScene.find(bpy.context.scene).objects("Mesh")


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
    pump_until(lambda: jobs[0].stage == "scene")
    jobs[0].cancel()
    pump_until(lambda: jobs[2].status == "RUNNING")
    assert [j.status for j in jobs[:2]] == [CANCELLED, CANCELLED]


def test_import_of_a_result_is_one_undo_step(ready):
    ready.import_when_done = False
    bpy.ops.mgf.reconstruct()
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.mgf.import_result("EXEC_DEFAULT", True)
    assert len(ImportedScene.find(bpy.context.scene).objects("Mesh")) == 1
    bpy.ops.ed.undo()
    imported = ImportedScene.find(bpy.context.scene)
    assert len(imported.objects("Cameras")) == 12 and not imported.objects("Mesh") and not imported.objects("Renders")
    bpy.ops.ed.redo()
    assert len(ImportedScene.find(bpy.context.scene).objects("Mesh")) == 1


def test_broken_result_is_a_sentence_not_a_traceback(ready, engine, house):
    (house.job / "mesh.ply").write_bytes(b"ply\nend_header\n")
    bpy.ops.mgf.reconstruct()
    job = runner.jobs()[-1]
    assert job.status == DONE and "damaged" in job.warnings[-1]
    assert not ImportedScene.find(bpy.context.scene).objects("Mesh")


def test_masks_of_all_photos_are_a_job(ready):
    assert bpy.ops.mgf.find_masks() == {"FINISHED"}
    assert arguments(ready.job_folder)[0] == "masks"


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
