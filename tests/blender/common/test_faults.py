# SPDX-License-Identifier: GPL-3.0-or-later
"""A fault of the add-on's own in one callback: it is shown, and the timers and the other jobs go on."""

from __future__ import annotations

import time
from pathlib import Path

import bpy
import pytest

from mgf_blender.common import runner
from mgf_blender.common.job import CANCELLED, DONE, FAILED, Job
from mgf_blender.jobs import import_status
from mgf_blender.prompts import files, preview
from mgf_blender.reconstruct import preview_image
from mgf_blender.reconstruct.start import make_job
from mgf_blender.results import async_import
from mgf_blender.scene_import.imported_scene import ImportedScene

WORDS = "The add-on made a mistake"


@pytest.fixture
def ready(addon, engine, house):
    engine("ok", FAKE_RESULT=house.job)
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    addon.job_folder = str(house.folder.parent / "new job")
    files.add_click(addon.photos[0], 9, 9, False, "building")
    return addon


def broken(*_: object, **__: object) -> None:
    raise RuntimeError("Error: Cannot read the picture")


def tick(until, seconds: float = 20.0) -> None:
    """What Blender's timer does: it never calls a function again that raised."""
    end = time.monotonic() + seconds
    while not until() and time.monotonic() < end:
        runner._tick()
        time.sleep(0.005)
    assert until()


def test_a_listener_that_raises_stops_nothing(ready, monkeypatch, tmp_path):
    monkeypatch.setattr(preview_image, "show", broken)
    monkeypatch.setenv("FAKE_PREVIEW", str(tmp_path / "p.png"))
    job = make_job(bpy.context.scene)
    runner.submit(job)
    tick(lambda: not job.live)
    assert job.status == DONE and len(ImportedScene.find(bpy.context.scene).objects("Mesh")) == 1
    assert [WORDS in text for text in job.warnings] == [False, True] and "Cannot read the picture" in job.warnings[1]


def test_an_operator_that_raises_is_one_sentence(ready, monkeypatch, capfd):
    monkeypatch.setattr("mgf_blender.scene_import.operators.import_scene", broken)
    with pytest.raises(RuntimeError) as raised:
        bpy.ops.mgf.import_colmap(filepath="//anywhere")
    assert WORDS in str(raised.value) and "Traceback" not in str(raised.value)
    assert "Traceback" in capfd.readouterr().err  # the console has the rest


def test_sentences_of_operators_speak_of_buttons_and_name_a_path_once(ready, engine, tmp_path):
    engine("full")
    with pytest.raises(RuntimeError, match="free some space and press Resume"):
        bpy.ops.mgf.reconstruct()
    with pytest.raises(RuntimeError) as raised:
        bpy.ops.mgf.import_prompts(filepath=str(tmp_path / "no.json"))
    assert str(raised.value).count("no.json") == 1 and "(No such file or directory)" in str(raised.value)


def test_a_path_that_the_system_refuses_is_no_mistake_of_ours(ready):
    ready.job_folder = "x" * 300
    with pytest.raises(RuntimeError, match=r"Cannot use '.*' \(File name too long\)"):
        bpy.ops.mgf.import_sfm()


def test_faults_at_the_end_and_at_the_start_leave_no_job_behind(ready, monkeypatch):
    jobs = []
    for i in range(3):
        ready.job_folder = f"{ready.job_folder} {i}"
        jobs.append(make_job(bpy.context.scene))
        runner.submit(jobs[-1])
    jobs[0].on_end = broken
    monkeypatch.setattr(jobs[1], "command", [0])  # Popen raises a TypeError
    ends = []
    jobs[1].on_end = ends.append
    tick(lambda: not any(j.live for j in jobs))
    assert [j.status for j in jobs] == [DONE, FAILED, DONE]
    assert WORDS in jobs[0].warnings[-1] and WORDS in jobs[1].text and ends == [jobs[1]]


def test_a_job_that_cannot_be_followed_is_ended(ready, monkeypatch, engine):
    engine("slow")
    job = make_job(bpy.context.scene)
    runner.submit(job)
    tick(lambda: job.stage == "scene")
    monkeypatch.setattr(job.process, "lines", broken)
    runner._tick()
    assert job.status == FAILED and WORDS in job.text and job.process.wait(5.0)


def test_cancelled_before_its_start_with_a_broken_listener(tmp_path):
    job = Job(["x"], Path(tmp_path), "house", on_end=broken)
    job.cancel()
    assert job.status == CANCELLED and WORDS in job.warnings[-1]


@pytest.mark.parametrize("place", ["mesh_steps", "_import"])
def test_an_arrival_that_raises_is_dropped_and_said(ready, house, monkeypatch, place):
    scene = bpy.context.scene
    with monkeypatch.context() as patch:
        patch.setattr(async_import, place, broken)
        async_import.begin(scene, house.job)
        end = time.monotonic() + 20
        while async_import._tick() is not None and time.monotonic() < end:
            time.sleep(0.002)
    assert not import_status.under_way(scene) and WORDS in import_status.problem(scene)
    assert not [m for m in bpy.data.meshes if "mgf_importing" in m]
    async_import.begin(scene, house.job)  # and can be tried again
    while async_import.pump():
        time.sleep(0.002)
    assert len(ImportedScene.find(scene).objects("Mesh")) == 1 and not import_status.problem(scene)


def test_a_preview_that_raises_is_said(ready, monkeypatch, engine):
    engine("slow")
    found = preview.start(bpy.context.scene, ready.photos[0])
    monkeypatch.setattr(found.process, "lines", broken)
    assert preview._tick() is None and found.status == preview.FAILED and WORDS in found.text
    preview._wanted[ready.key, ready.photos[0].name] = 0.0
    monkeypatch.setattr(preview, "start", broken)
    ready.auto_preview = True
    assert preview._tick() is None and not ready.auto_preview
