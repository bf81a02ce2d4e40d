# SPDX-License-Identifier: GPL-3.0-or-later
"""The mask preview: one photo, its own clicks, beside a running job, and everything that can go wrong."""

from __future__ import annotations

import json
import time

import bpy
import numpy as np
import pytest
from jobs import pump_until
from layouts import draw

from mgf_blender.common import runner
from mgf_blender.prompts import files, overlay, preview
from mgf_blender.prompts.panel import MGF_PT_prompts
from mgf_blender.reconstruct.start import make_job


@pytest.fixture
def state(addon, engine, house):
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    addon.job_folder = str(house.folder.parent / "new job")
    files.add_click(addon.photos[0], 100.5, 80.25, False, "building")
    files.add_click(addon.photos[1], 10, 8, False, "building")
    return addon


def pump(until) -> int:
    """Pump until it holds; returns how often."""
    return pump_until(until, preview.pump)


def test_button_shows_the_mask_of_the_photo(state):
    scene, photo = bpy.context.scene, state.photos[0]
    assert overlay.newest_mask(scene, photo) is None
    assert bpy.ops.mgf.preview_mask() == {"FINISHED"}
    path, binary = overlay.newest_mask(scene, photo)
    rgba = overlay.mask_rgba(path, binary)
    assert rgba.shape == (6, 8, 4) and binary
    assert (rgba[:, :3, 3] > 0).all() and (rgba[:, 5:, 3] == 0).all()
    assert overlay.newest_mask(scene, state.photos[1]) is None


def test_it_does_not_wait_for_a_job_nor_hold_the_window(state, engine):
    engine("slow")
    job = make_job(bpy.context.scene)
    runner.submit(job)
    runner.pump()
    found = preview.start(bpy.context.scene, state.photos[0])
    assert pump(lambda: found.status == preview.DONE) > 3  # the preview takes half a second, and none of them waits
    assert job.status == "RUNNING" and found.seconds > 0.4


def test_the_panel_keeps_its_height_meanwhile(state, engine):
    def rows():
        drawn = draw(MGF_PT_prompts)
        return [text for text, _ in drawn.texts], [name for name, *_ in drawn.operators]

    texts, operators = rows()
    assert "Preview Mask" in texts and "mgf.cancel_preview" not in operators
    engine("slow")
    found = preview.start(bpy.context.scene, state.photos[0])
    running, its = rows()
    assert running == [text.replace("Preview Mask", "Finding the building") for text in texts]
    assert "mgf.cancel_preview" in its and "mgf.preview_mask" not in its
    pump(lambda: found.status == preview.DONE)
    assert rows() == (texts, operators)


def test_the_newest_request_wins(state, engine):
    engine("slow")
    first = preview.start(bpy.context.scene, state.photos[0])
    second = preview.start(bpy.context.scene, state.photos[1])
    assert first.process.wait(5)
    pump(lambda: second.status == preview.DONE)
    assert preview.newest(bpy.context.scene, state.photos[0].name) is None


def test_automatic_previews_follow_the_clicks(state):
    scene, photo = bpy.context.scene, state.photos[0]
    preview.note_clicks(scene, photo)
    assert not preview.pump()  # switched off
    assert not state.key
    state.auto_preview = True
    preview.note_clicks(scene, photo)
    pump(
        lambda: (
            preview.newest(scene, photo.name) is not None and preview.newest(scene, photo.name).status == preview.DONE
        )
    )
    first = preview.newest(scene, photo.name)
    preview.note_clicks(scene, photo)
    assert not preview.pump()  # nothing changed
    photo.clicks[0].uv = (50, 60)
    preview.note_clicks(scene, photo)
    pump(lambda: preview.newest(scene, photo.name) is not first and not preview.pump())
    assert preview.newest(scene, photo.name).clicks == preview.signature(photo) != first.clicks


def test_what_is_wrong_is_one_sentence(state, engine, monkeypatch, tmp_path):
    engine("bad")
    with pytest.raises(RuntimeError, match="The scene has no photos; give another folder"):
        bpy.ops.mgf.preview_mask()
    import sys

    monkeypatch.setenv("MGF_ENGINE_PYTHON", sys.executable)
    with pytest.raises(RuntimeError, match="has no MGF engine"):
        bpy.ops.mgf.preview_mask()
    monkeypatch.setenv("MGF_ENGINE_PYTHON", str(tmp_path / "gone"))
    with pytest.raises(RuntimeError, match="There is no Python in"):
        bpy.ops.mgf.preview_mask()
    state.auto_preview = True
    preview._start_wanted(state.key, state.photos[0].name)
    assert not state.auto_preview
    state.photos[0].clicks.clear()
    with pytest.raises(RuntimeError, match="Click at least one point"):
        bpy.ops.mgf.preview_mask()


def test_disabling_ends_it(state, engine):
    engine("slow")
    found = preview.start(bpy.context.scene, state.photos[0])
    preview.unregister()
    assert found.process.wait(5) and preview.newest(bpy.context.scene, state.photos[0].name) is None


def test_a_preview_goes_with_the_last_of_its_clicks(state, tmp_path):
    """Points of a file replace all that the mask came of."""
    scene, photo = bpy.context.scene, state.photos[0]
    bpy.ops.mgf.preview_mask()
    before = overlay.newest_mask(scene, photo)
    files.add_click(photo, 60, 60, False, "building")
    assert overlay.newest_mask(scene, photo) == before and "have changed" in said()
    path = tmp_path / "prompts.json"
    path.write_text(json.dumps({photo.name: {"positive": [[30.5, 40.5]], "negative": []}}))
    bpy.ops.mgf.import_prompts("EXEC_DEFAULT", True, filepath=str(path))
    photo = scene.mgf.photos[0]
    assert len(photo.clicks) == 1 and overlay.newest_mask(scene, photo) is None and "have changed" not in said()
    photo.clicks.clear()
    assert overlay.newest_mask(scene, photo) is None
    files.add_click(photo, 100.5, 80.25, False, "building")
    assert overlay.newest_mask(scene, photo) == before


def said() -> str:
    """What the panel says."""
    return " ".join(text for text, _ in draw(MGF_PT_prompts).texts)


def test_a_job_that_is_newer_than_the_preview_is_shown(state, tmp_path):
    import os

    import synthetic

    bpy.ops.mgf.preview_mask()
    name = state.photos[0].name
    job = tmp_path / "job"
    synthetic.write_png(job / "masks" / "a.png", np.ones((4, 4), np.uint8))
    (job / "masks" / "scores.json").write_text(json.dumps({"views": [{"name": name, "labels": "a.png"}]}))
    state.job_folder = str(job)
    os.utime(job / "masks" / "a.png", (1, 1))
    assert overlay.newest_mask(bpy.context.scene, state.photos[0])[1]
    later = time.time() + 100
    os.utime(job / "masks" / "a.png", (later, later))
    assert overlay.newest_mask(bpy.context.scene, state.photos[0]) == (job / "masks" / "a.png", False)


def test_an_old_preview_never_wins_over_the_mask_of_all_photos(state, tmp_path):
    """Masks of all photos, a click more, its preview, and the click undone."""
    import synthetic

    scene, photo = bpy.context.scene, state.photos[0]
    job = tmp_path / "job"
    synthetic.write_png(job / "masks" / "a.png", np.ones((4, 4), np.uint8))
    (job / "masks" / "scores.json").write_text(json.dumps({"views": [{"name": photo.name, "labels": "a.png"}]}))
    files.write(scene, job / "prompts.json")  # as the engine keeps them
    state.job_folder = str(job)
    of_all = (job / "masks" / "a.png", False)
    assert overlay.newest_mask(scene, photo) == of_all and overlay.job_knows(scene, photo)
    bpy.ops.mgf.preview_mask()  # of the same clicks, asked for by hand
    assert overlay.newest_mask(scene, photo) == of_all

    files.add_click(photo, 60, 60, False, "building")
    assert overlay.newest_mask(scene, photo) == of_all  # the preview there is, is of other clicks
    bpy.ops.mgf.preview_mask()
    found = preview.newest(scene, photo.name)
    assert overlay.newest_mask(scene, photo) == (found.mask, True)
    files.add_click(photo, 70, 60, False, "building")
    preview.start(scene, photo)
    assert overlay.newest_mask(scene, photo) == (found.mask, True)  # until the next one is there
    pump(lambda: not preview.under_way(scene, photo.name))
    assert overlay.newest_mask(scene, photo)[0] == preview.newest(scene, photo.name).mask != found.mask
    for _ in range(2):
        photo.clicks.remove(len(photo.clicks) - 1)
    assert overlay.newest_mask(scene, photo) == of_all
    (job / "prompts.json").unlink()  # a job of an earlier version
    assert overlay.newest_mask(scene, photo) == of_all
