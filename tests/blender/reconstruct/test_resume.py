# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs that were interrupted are found again and resumed with what they were started with."""

from __future__ import annotations

import json
from pathlib import Path

import bpy
import pytest
from jobs import arguments, pump_until
from layouts import draw

from mgf_blender.common import runner
from mgf_blender.reconstruct.operators import interrupted
from mgf_blender.reconstruct.panel import MGF_PT_reconstruct
from mgf_blender.reconstruct.start import make_job
from mgf_blender.scene_import.imported_scene import ImportedScene


def test_second_run_resumes_in_its_folder(ready):
    bpy.ops.mgf.reconstruct()
    bpy.ops.mgf.reconstruct()
    assert "--resume" in arguments(ready.job_folder)
    assert len(ImportedScene.find(bpy.context.scene).objects("Mesh")) == 1


def test_option_set_back_to_default_reaches_a_resumed_job(ready):
    ready.options.resolution = 600
    bpy.ops.mgf.reconstruct()
    ready.options.resolution = 750
    bpy.ops.mgf.reconstruct()
    assert "resolution=750" in arguments(ready.job_folder)


def quit_during(stage, engine, tmp_path) -> None:
    """Starts a job, saves the file, leaves Blender in this stage and opens the file again."""
    engine("slow")
    job = make_job(bpy.context.scene)
    runner.submit(job)
    pump_until(lambda: job.stage == stage)
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
    assert "--resume" in arguments(scene.mgf.job_folder)


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
    before = arguments(ready.job_folder)
    ready.options.preset, ready.options.screening, ready.options.opacity_level = "standard", True, 0.5
    ready.options.level_steps = 5  # which the job was not given
    engine("ok")
    bpy.ops.mgf.resume()
    assert arguments(ready.job_folder) == [*before, "--resume"]
    assert (ready.options.preset, ready.options.resolution, ready.options.screening) == ("draft", 320, False)


def test_resume_goes_on_with_the_command_that_ended_early(ready, engine):
    engine("silent")
    with pytest.raises(RuntimeError):
        bpy.ops.mgf.find_masks()
    engine("ok")
    bpy.ops.mgf.resume()
    assert arguments(ready.job_folder)[0] == "masks" and "--resume" in arguments(ready.job_folder)
    bpy.ops.mgf.reconstruct()
    bpy.ops.mgf.resume()  # from a script: the last job is done, so it is the whole way again
    assert arguments(ready.job_folder)[0] == "reconstruct"
