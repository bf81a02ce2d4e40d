# SPDX-License-Identifier: GPL-3.0-or-later
"""The estimate before a job: true to measured jobs, and learning from this machine's own."""

from __future__ import annotations

import json

import bpy
import pytest

from mgf_blender.reconstruct import estimate as module
from mgf_blender.reconstruct.estimate import Photos, duration, estimate, learn, photos_of, speed_factor

#: Reports of jobs on two cores with AVX-512: preset, photos and their size, seconds of the first four stages, peak GB.
MEASURED = [
    ("standard", Photos(146, (750, 500)), 288.8, 3.06),  # steel_frame_hall
    ("draft", Photos(146, (750, 500)), 100.9, 2.09),
    ("draft", Photos(25, (3072, 2048)), 53.0, 1.45),  # herzjesu
    ("draft", Photos(30, (480, 320)), 26.5, 0.99),  # demo
]


@pytest.fixture
def folder(addon, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "user_folder", lambda: tmp_path)
    return tmp_path


@pytest.mark.parametrize(("preset", "photos", "seconds", "memory"), MEASURED)
def test_measured_jobs(addon, folder, preset, photos, seconds, memory):
    addon.options.preset = preset
    found = estimate(addon.options, photos, factor=1.0)
    whole = seconds + module._START + module._DELIVER_PHOTO * photos.at_work(addon.options)[0]
    assert found.seconds == pytest.approx(whole, rel=0.2)
    assert found.memory / 1e9 == pytest.approx(memory, rel=0.2)


def test_more_work_costs_more(addon, folder):
    base, more = estimate(addon.options, Photos(20)), estimate(addon.options, Photos(40))
    assert more.seconds > base.seconds and more.memory > base.memory
    addon.options.preset = "fine"
    fine = estimate(addon.options, Photos(20))
    assert fine.seconds > 2 * base.seconds and fine.memory > base.memory


def test_small_photos_are_not_enlarged_and_no_more_are_taken_than_wanted(addon, folder):
    small, large = Photos(40, (480, 320)), Photos(40, (6000, 4000))
    assert estimate(addon.options, small).seconds < 0.8 * estimate(addon.options, large).seconds
    assert estimate(addon.options, small).memory < estimate(addon.options, large).memory
    addon.options.max_photos = 40
    many = Photos(600, (480, 320))
    assert estimate(addon.options, many) == estimate(addon.options, small)


def test_few_photos_train_shorter(addon, folder):
    seconds = [estimate(addon.options, Photos(count), factor=1.0).seconds for count in (20, 80)]
    addon.options.iterations = 3000
    longer = [estimate(addon.options, Photos(count), factor=1.0).seconds for count in (20, 80)]
    assert seconds[0] < 0.6 * longer[0] and seconds[1] == longer[1]


def test_the_photos_of_a_scene(addon, house, folder):
    assert photos_of(bpy.context.scene) == Photos(1)
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    found = photos_of(bpy.context.scene)
    assert found.count == sum(o.get("mgf_kind") == "Cameras" for o in bpy.data.objects) > 0
    assert found.size[0] >= found.size[1] > 0


def test_it_learns_the_speed_of_the_machine(addon, folder):
    report, photos = folder / "report.json", Photos(20)
    usual = estimate(addon.options, photos, factor=1.0).seconds
    report.write_text(json.dumps({"seconds": 3 * usual}))
    assert learn(addon.options, photos, folder) == pytest.approx(3, rel=0.1)
    assert estimate(addon.options, photos).seconds == pytest.approx(3 * usual, rel=0.1)
    report.write_text(json.dumps({"seconds": usual}))
    assert 1.2 < learn(addon.options, photos, folder) < 2.5  # half the way back
    for text in ("{", "{}", json.dumps({"seconds": 1e9})):
        report.write_text(text)
        assert learn(addon.options, photos, folder) is None
    (folder / "speed.json").write_text('{"factor": "fast"}')
    addon.options.threads = 2
    assert speed_factor(addon.options) == 1.0


def test_a_finished_job_teaches_unless_it_used_earlier_results(addon, engine, house, folder, monkeypatch):
    seen = []
    monkeypatch.setattr(module, "learn", lambda options, photos, path: seen.append(photos.count))
    engine("ok", FAKE_RESULT=house.job)
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    addon.photos[0].clicks.add()
    bpy.ops.mgf.reconstruct()
    assert len(seen) == 1
    engine("cached")
    bpy.ops.mgf.reconstruct()
    assert len(seen) == 1


def test_durations():
    assert [duration(s) for s in (None, 0.2, 89, 91, 3600, 7500)] == ["", "0 s", "89 s", "2 min", "60 min", "2 h 5 min"]
