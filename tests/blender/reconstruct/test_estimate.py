# SPDX-License-Identifier: GPL-3.0-or-later
"""The estimate before a job: the engine's own, of the same photos, times what this machine was found to need."""

from __future__ import annotations

import json
import os
import subprocess

import bpy
import pytest
import synthetic
from conftest import REPO

from mgf_blender.common import options
from mgf_blender.common.text import format_duration
from mgf_blender.reconstruct import estimate as module
from mgf_blender.reconstruct.estimate import PhotoSizes, estimate, photos_of, remember, speed


@pytest.fixture
def folder(addon, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "user_folder", lambda: tmp_path)
    return tmp_path


@pytest.mark.parametrize("preset", ["fine", "paper"])
def test_it_is_what_the_engine_says(addon, folder, house, preset):
    python = REPO / ".venv" / "bin" / "python"
    if not python.is_file():
        pytest.skip("the engine's environment (.venv) is not here; make test builds it")
    addon.options.preset, addon.options.resolution, addon.options.threads = preset, 100, 3
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    command = [str(python), "-m", "mgf_engine", "estimate", str(house.folder), "--json"]
    command += options.arguments(addon.options)
    cache = {**os.environ, "XDG_CACHE_HOME": str(folder), "LOCALAPPDATA": str(folder)}  # nothing learned
    said = json.loads(subprocess.run(command, capture_output=True, text=True, cwd=REPO, env=cache, check=True).stdout)
    found = estimate(addon.options, photos_of(bpy.context.scene), factor=1.0)
    assert found.seconds == pytest.approx(said["seconds"], rel=0.02)
    assert found.memory == pytest.approx(said["bytes"], rel=0.02)


def test_more_work_costs_more(addon, folder):
    base, more = estimate(addon.options, PhotoSizes(20)), estimate(addon.options, PhotoSizes(40))
    assert more.seconds > base.seconds and more.memory > base.memory
    addon.options.preset = "fine"
    fine = estimate(addon.options, PhotoSizes(20))
    assert fine.seconds > 2 * base.seconds and fine.memory > base.memory


def test_small_photos_are_not_enlarged_and_no_more_are_taken_than_wanted(addon, folder):
    small, large = PhotoSizes(40, (480, 320)), PhotoSizes(40, (6000, 4000))
    assert estimate(addon.options, small).seconds < 0.8 * estimate(addon.options, large).seconds
    assert estimate(addon.options, small).memory < estimate(addon.options, large).memory
    addon.options.max_photos = 40
    many = PhotoSizes(600, (480, 320))
    assert estimate(addon.options, many) == estimate(addon.options, small)


def test_few_photos_train_shorter(addon, folder):
    seconds = [estimate(addon.options, PhotoSizes(count), factor=1.0).seconds for count in (20, 80)]
    addon.options.iterations = 3000
    longer = [estimate(addon.options, PhotoSizes(count), factor=1.0).seconds for count in (20, 80)]
    assert seconds[0] < 0.6 * longer[0] and seconds[1] == longer[1]


def test_the_photos_of_a_scene(addon, house, folder):
    assert photos_of(bpy.context.scene) == PhotoSizes(1)
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    found = photos_of(bpy.context.scene)
    assert found.count == sum(o.get("mgf_kind") == "Cameras" for o in bpy.data.objects) > 0
    assert found.size[0] >= found.size[1] > 0


def test_results_of_other_photos_beside_them_are_no_part_of_the_next_job(addon, house, engine, folder, tmp_path):
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    before = photos_of(bpy.context.scene)
    other = synthetic.write_house(tmp_path / "other")
    content = json.loads((other.job / "deliver.json").read_text())
    content["views"] = [{**view, "name": "other/" + view["name"]} for view in content["views"][:5]]
    (other.job / "deliver.json").write_text(json.dumps(content))
    bpy.ops.mgf.import_result(directory=str(other.job))
    bpy.ops.mgf.add_crop_box()  # around the other building
    assert photos_of(bpy.context.scene) == before
    addon.photos[0].clicks.add()
    bpy.ops.mgf.reconstruct()
    assert addon.options.crop_box == ""


def test_what_the_engine_says_of_the_machine_is_kept(addon, folder):
    usual = estimate(addon.options, PhotoSizes(20)).seconds
    remember(3.0)
    assert estimate(addon.options, PhotoSizes(20)).seconds == pytest.approx(3 * usual)
    for text in ("{", "{}", '{"factor": "fast"}', '{"factor": 1e9}'):
        (folder / "speed.json").write_text(text)
        assert speed() == 1.0


def test_a_finished_job_tells_the_speed_unless_it_used_earlier_results(addon, engine, house, folder):
    engine("ok", FAKE_RESULT=house.job)
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    addon.photos[0].clicks.add()
    bpy.ops.mgf.reconstruct()
    assert speed() == 1.25
    remember(2.0)
    engine("cached")
    bpy.ops.mgf.reconstruct()
    assert speed() == 2.0


def test_durations():
    seconds = (None, 0.2, 89, 91, 3600, 7500)
    texts = ["", "0 s", "89 s", "2 min", "60 min", "2 h 5 min"]
    assert [format_duration(s) for s in seconds] == texts
