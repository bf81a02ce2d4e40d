# SPDX-License-Identifier: GPL-3.0-or-later
"""The clicks of a job come back with its result into a scene that has none."""

from __future__ import annotations

import json

import bpy
import pytest

from mgf_blender.prompts import files
from mgf_blender.scene_import.imported_scene import ImportedScene


@pytest.fixture
def job(addon, house):
    """A job with two clicked photos, one of which the scene has, of a scene that is imported."""
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    name = sorted(house.poses)[0]
    clicks = {name: {"positive": [[50, 60]], "negative": [[5, 6]]}, "gone.png": {"positive": [[1, 2]]}}
    (house.job / "prompts.json").write_text(json.dumps(clicks))
    return house.job


def test_clicks_come_back(addon, job):
    bpy.ops.mgf.import_result(directory=str(job))
    clicks = json.loads((job / "prompts.json").read_text())
    assert files.to_data(bpy.context.scene) == {name: clicks[name] for name in clicks if name != "gone.png"}


def test_clicks_of_the_scene_stay(addon, job):
    files.add_click(addon.photos[1], 7, 8, False, "building")
    before = files.to_data(bpy.context.scene)
    bpy.ops.mgf.import_result(directory=str(job))
    assert files.to_data(bpy.context.scene) == before


def test_a_damaged_file_of_clicks_keeps_no_mesh_away(addon, job):
    (job / "prompts.json").write_text("{")
    assert bpy.ops.mgf.import_result(directory=str(job)) == {"FINISHED"}
    assert ImportedScene.find(bpy.context.scene).objects("Mesh") and not files.to_data(bpy.context.scene)
