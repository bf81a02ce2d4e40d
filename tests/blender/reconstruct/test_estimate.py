# SPDX-License-Identifier: GPL-3.0-or-later
"""The estimate before a job: true to measured jobs, and learning from this machine's own."""

from __future__ import annotations

import json

import bpy
import pytest

from mgf_blender.reconstruct import estimate as module
from mgf_blender.reconstruct.estimate import duration, estimate, learn, speed_factor

#: Reports of jobs on two cores with AVX-512: preset, options, photos, seconds of the first four stages, peak GB
#: (None: not measured).
MEASURED = [
    ("standard", {}, 11, 343.5, 1.93),
    ("standard", {}, 64, 438.0, 2.57),
    ("standard", {}, 11, 288.3, 1.49),
    ("standard", {}, 25, 450.5, 2.00),
    ("standard", {}, 11, 350.5, 1.74),
    ("draft", {"resolution": 320, "iterations": 150}, 11, 16.6, 0.61),
    ("draft", {"resolution": 300, "iterations": 150}, 30, 50.0, None),
]


@pytest.fixture
def folder(addon, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "user_folder", lambda: tmp_path)
    return tmp_path


@pytest.mark.parametrize(("preset", "options", "photos", "seconds", "memory"), MEASURED)
def test_measured_jobs(addon, folder, preset, options, photos, seconds, memory):
    addon.options.preset = preset
    for name, value in options.items():
        setattr(addon.options, name, value)
    found = estimate(addon.options, photos, factor=1.0)
    whole = seconds + module._START + module._DELIVER_PHOTO * photos
    assert found.seconds == pytest.approx(whole, rel=0.2)
    if memory is not None:
        assert found.memory / 1e9 == pytest.approx(memory, rel=0.2)


def test_more_work_costs_more(addon, folder):
    base = estimate(addon.options, 20)
    assert estimate(addon.options, 40).seconds > base.seconds and estimate(addon.options, 40).memory > base.memory
    addon.options.preset = "fine"
    assert estimate(addon.options, 20).seconds > 3 * base.seconds and estimate(addon.options, 20).memory > base.memory


def test_it_learns_the_speed_of_the_machine(addon, folder):
    report = folder / "report.json"
    usual = estimate(addon.options, 20, factor=1.0).seconds
    report.write_text(json.dumps({"seconds": 3 * usual, "counts": {"photos": 20}}))
    assert learn(addon.options, folder) == pytest.approx(3, rel=0.1)
    assert estimate(addon.options, 20).seconds == pytest.approx(3 * usual, rel=0.1)
    report.write_text(json.dumps({"seconds": usual, "counts": {"photos": 20}}))
    assert 1.2 < learn(addon.options, folder) < 2.5  # half the way back
    for text in ("{", "{}", json.dumps({"seconds": 1e9, "counts": {"photos": 20}})):
        report.write_text(text)
        assert learn(addon.options, folder) is None
    (folder / "speed.json").write_text('{"factor": "fast"}')
    addon.options.threads = 2
    assert speed_factor(addon.options) == 1.0


def test_a_finished_job_teaches_unless_it_used_earlier_results(addon, engine, house, folder, monkeypatch):
    seen = []
    monkeypatch.setattr(module, "learn", lambda options, path: seen.append(path))
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
