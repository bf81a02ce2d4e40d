# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators in odd states: some of the calls of :mod:`odd_states`, and those that failed once."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import bpy
import pytest

from mgf_blender.scene_import.crop import find_crop_box
from mgf_blender.scene_import.imported_scene import OFFSET_KEY, ImportedScene


def test_operators_in_odd_states(tmp_path):
    """Thirty of them; docs/stability.md tells of the thousands."""
    here = Path(__file__).parent
    command = [sys.executable, str(here / "odd_states.py"), "2", "30", str(tmp_path)]
    environment = {**os.environ, "BLENDER_USER_RESOURCES": str(tmp_path / "user")}
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, env=environment)
    if done.returncode or "survived" not in done.stdout:
        pytest.fail(f"ended with {done.returncode}\n{done.stdout[-4000:]}\n{done.stderr[-2000:]}", pytrace=False)


def test_a_context_without_window_has_a_selection(ready):
    """As timers have it."""
    with bpy.context.temp_override(window=None):
        assert bpy.ops.mgf.add_crop_box() == {"FINISHED"}
        with pytest.raises(RuntimeError, match="Select a plane or an empty of your own first"):
            bpy.ops.mgf.use_as_section()
        with pytest.raises(RuntimeError, match="Select exactly two vertices or two objects first"):
            bpy.ops.mgf.set_scale(distance=2.0)
    assert bpy.context.selected_objects == [find_crop_box(ImportedScene.find(bpy.context.scene))]


def test_a_system_without_program_for_a_file_is_named(ready, house, monkeypatch, tmp_path):
    ready.job_folder = str(house.job)
    (house.job / "log.txt").write_text("log")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(RuntimeError, match=r"^Error: No program of the system opens '.*log\.txt'; open it yourself\.$"):
        bpy.ops.mgf.open_job_file(name="log.txt")


@pytest.mark.parametrize("name", ["export_prompts", "import_prompts"])
def test_scripts_that_give_no_file_are_told(ready, name):
    with pytest.raises(RuntimeError, match="No file was chosen"):
        getattr(bpy.ops.mgf, name)(filepath="")


def test_scripts_that_give_no_job_are_told(ready):
    ready.job_folder = ""
    with pytest.raises(RuntimeError, match="No job was chosen; choose the folder of a finished job"):
        bpy.ops.mgf.import_result()
    assert ready.job_folder == ""


def test_a_scene_without_job_is_not_given_one_by_looking(ready):
    ready.job_folder = ""
    for name in ("place_scene", "show_drawing"):
        with pytest.raises(RuntimeError, match="poll"):
            getattr(bpy.ops.mgf, name)()
    bpy.ops.mgf.take_control_points()
    assert ready.job_folder == ""


def test_resume_that_cannot_start_leaves_the_options(ready, house, monkeypatch):
    folder = Path(ready.job_folder)
    shutil.copytree(house.job, folder)
    (folder / "job.json").write_text('{"given": {"preset": "draft", "iterations": "77"}, "stages": {}}')
    ready.options.preset, ready.options.max_faces = "standard", 4321
    monkeypatch.setenv("MGF_ENGINE_PYTHON", str(folder / "nowhere"))
    with pytest.raises(RuntimeError, match="There is no Python in"):
        bpy.ops.mgf.resume()
    assert (ready.options.preset, ready.options.max_faces) == ("standard", 4321)
    assert ready.options.iterations != 77


def test_an_empty_that_has_lost_what_it_knew_is_no_scene(ready):
    del ImportedScene.find(bpy.context.scene).root[OFFSET_KEY]
    assert ImportedScene.find(bpy.context.scene) is None
    bpy.ops.mgf.reload_scene()
    assert ImportedScene.find(bpy.context.scene) is not None
