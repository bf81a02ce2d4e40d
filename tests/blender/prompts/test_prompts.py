# SPDX-License-Identifier: GPL-3.0-or-later
"""Clicks: the list of root photos, files, saving, and what the tool does with them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import bpy
import numpy as np
import pytest
import synthetic

from mgf_blender.common.errors import UserError
from mgf_blender.prompts import files, overlay
from mgf_blender.prompts.properties import photo_image, photo_of_image
from mgf_blender.prompts.tool import nearest
from mgf_blender.scene_import.colmap import read_model
from mgf_blender.scene_import.roots import choose_roots


@pytest.fixture
def state(addon, house):
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    return addon


def test_roots_are_a_fifth_and_spread(state, house):
    model = read_model(house.model)
    chosen = choose_roots(model)
    assert [p.name for p in state.photos] == [model.photos[i].name for i in chosen] and len(chosen) == 3
    angles = sorted(np.degrees(2 * np.pi * i / 12) for i in chosen)
    assert min(np.diff([*angles, angles[0] + 360])) >= 60
    assert all(p.file and p.width for p in state.photos)


def test_photos_of_one_name_in_two_folders_are_told_apart(state, tmp_path):
    for folder, photo in zip("ab", state.photos[:2], strict=True):
        path = (tmp_path / folder / "IMG_1").with_suffix(Path(photo.file).suffix)
        path.parent.mkdir()
        photo.file = str(shutil.copyfile(photo.file, path))
    images = [photo_image(photo) for photo in state.photos[:2]]
    assert [photo_of_image(bpy.context.scene, image) for image in reversed(images)] == [1, 0]
    state.photos[0].file = images[0].filepath = ""  # nothing is not the same as nothing
    assert photo_of_image(bpy.context.scene, images[0]) == -1


def test_file_round_trip(state, tmp_path):
    photo = state.photos[1]
    files.add_click(photo, 10.25, 20.5, False, "building")
    files.add_click(photo, 30, 40, True, "building")
    files.add_click(photo, 50, 60, False, "window")
    path = tmp_path / "out" / "prompts.json"
    bpy.ops.mgf.export_prompts(filepath=str(path))
    data = {photo.name: {"positive": [[10.25, 20.5]], "negative": [[30.0, 40.0]], "parts": {"window": [[50.0, 60.0]]}}}
    assert json.loads(path.read_text()) == data
    assert [p.name for p in path.parent.iterdir()] == ["prompts.json"]
    photo.clicks.clear()
    bpy.ops.mgf.import_prompts(filepath=str(path))
    assert files.to_data(bpy.context.scene) == data


def test_import_adds_photos_that_were_not_roots(state, house, tmp_path):
    other = next(n for n in house.poses if n not in {p.name for p in state.photos})
    path = tmp_path / "p.json"
    path.write_text(json.dumps({other: {"positive": [[1, 2]]}, "unknown.png": {"positive": [[1, 2]]}}))
    bpy.ops.mgf.import_prompts(filepath=str(path))
    assert files.to_data(bpy.context.scene) == {other: {"positive": [[1.0, 2.0]]}}
    names = [photo.name for photo in state.photos]
    assert state.photos[other].file and names == sorted(names)


def test_an_image_editor_keeps_what_is_no_photo_of_the_list(state):
    area = max(bpy.context.window.screen.areas, key=lambda a: a.width * a.height)
    area.type = "IMAGE_EDITOR"
    drawing = area.spaces.active.image = bpy.data.images.new("drawing", 4, 4)
    state.photo_index = 1
    assert area.spaces.active.image == drawing
    area.spaces.active.image = photo_image(state.photos[1])
    state.photo_index = 2
    assert area.spaces.active.image == photo_image(state.photos[2])


@pytest.mark.parametrize(
    "text", ["{", "[1]", '{"a": []}', '{"a": {"positive": [[1]]}}', '{"a": {"positive": [["x", 2]]}}']
)
def test_bad_files_change_nothing(state, tmp_path, text):
    files.add_click(state.photos[0], 1, 2, False, "building")
    path = tmp_path / "p.json"
    path.write_text(text)
    with pytest.raises(RuntimeError, match=r"Cannot read|not a prompts file"):
        bpy.ops.mgf.import_prompts(filepath=str(path))
    assert len(state.photos[0].clicks) == 1


def test_a_name_that_two_photos_have_is_none_of_them(state, tmp_path):
    for folder, photo in zip("ab", state.photos[:2], strict=True):
        photo.name = f"{folder}/IMG_1.png"
    path = tmp_path / "p.json"
    clicks = {"positive": [[1, 2]]}
    path.write_text(json.dumps({"IMG_1.png": clicks, "b/IMG_1.png": clicks, state.photos[2].name.upper(): clicks}))
    bpy.ops.mgf.import_prompts(filepath=str(path))
    assert [len(photo.clicks) for photo in state.photos] == [0, 1, 1]


def test_foreign_prompts_are_refused(state, tmp_path):
    path = tmp_path / "p.json"
    path.write_text('{"foreign.jpg": {"positive": [[1, 2]]}}')
    with pytest.raises(RuntimeError, match=r"has no photo 'foreign\.jpg'"):
        bpy.ops.mgf.import_prompts(filepath=str(path))


def test_unwritable_export(state):
    with pytest.raises(UserError, match="Cannot write"):
        files.write(bpy.context.scene, Path("/proc/nowhere/p.json"))


def test_clicks_survive_saving_undo_and_reimport(state, house, tmp_path):
    files.add_click(state.photos[0], 10, 20, False, "building")
    bpy.ops.ed.undo_push(message="one")
    files.add_click(bpy.context.scene.mgf.photos[0], 30, 40, True, "building")
    bpy.ops.ed.undo_push(message="two")
    bpy.ops.ed.undo()
    assert len(bpy.context.scene.mgf.photos[0].clicks) == 1
    bpy.ops.mgf.reload_scene()
    assert len(bpy.context.scene.mgf.photos[0].clicks) == 1
    path = str(tmp_path / "a.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    assert tuple(bpy.context.scene.mgf.photos[0].clicks[0].uv) == (10, 20)


def test_images_know_their_photo(state):
    scene = bpy.context.scene
    image = photo_image(state.photos[2])
    assert photo_of_image(scene, image) == 2
    assert photo_of_image(scene, None) == -1
    assert photo_of_image(scene, bpy.data.images.new("other", 4, 4)) == -1
    state.photos[2].file = "/nowhere.png"
    assert photo_image(state.photos[2]) is None


def test_nearest_click_within_reach(state):
    photo = state.photos[0]
    for u in (10, 14, 40):
        files.add_click(photo, u, 10, False, "building")
    assert nearest(photo, 13, 10, 5) == 1 and nearest(photo, 25, 10, 5) == -1


def test_list_operators(state):
    bpy.ops.mgf.next_photo()
    assert state.photo_index == 1
    bpy.ops.mgf.next_photo(step=-2)
    assert state.photo_index == len(state.photos) - 1
    count = len(state.photos)
    bpy.ops.mgf.look_through(step=1)
    while bpy.context.scene.camera["mgf_photo"] in {p.name for p in state.photos}:
        bpy.ops.mgf.look_through(step=1)
    bpy.ops.mgf.add_photo()
    added, names = bpy.context.scene.camera["mgf_photo"], [photo.name for photo in state.photos]
    assert len(names) == count + 1 and names == sorted(names) and names[state.photo_index] == added
    files.add_click(state.photos[added], 1, 1, False, "building")
    bpy.ops.mgf.reload_scene()  # the photos are listed anew
    assert [photo.name for photo in state.photos] == names and names[state.photo_index] == added
    bpy.ops.mgf.clear_clicks()
    assert not state.photos[added].clicks
    bpy.ops.mgf.remove_photo()
    assert len(state.photos) == count


def test_overlay_reads_the_masks_of_the_job(state, tmp_path):
    labels = np.zeros((20, 30), np.uint8)
    labels[5:15, 5:25] = 1
    labels[8:10, 8:12] = 3
    labels[0:2] = 255
    job = tmp_path / "job"
    synthetic.write_png(job / "masks" / "labels" / "a.png", labels)
    name = state.photos[0].name
    views = [{"name": name, "labels": "labels/a.png", "score": 0.9, "used": True, "flag": ""}]
    (job / "masks" / "scores.json").write_text(json.dumps({"views": views}))
    state.job_folder = str(job)
    entry = overlay.mask_entry(bpy.context.scene, name)
    assert entry["score"] == 0.9
    rgba = overlay.mask_rgba(Path(entry["labels"]))[::-1]
    assert rgba.shape == (20, 30, 4)
    assert rgba[12, 15, 3] > 0 and rgba[17, 15, 3] == 0  # building, background
    assert tuple(rgba[0, 3]) == pytest.approx(overlay._DOUBT) and tuple(rgba[4, 10]) == pytest.approx(overlay._EDGE)
    assert overlay.mask_entry(bpy.context.scene, "unknown") is None
    (job / "masks" / "scores.json").write_text("{")
    overlay.forget()
    assert overlay.mask_entry(bpy.context.scene, name) is None
