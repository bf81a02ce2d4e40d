# SPDX-License-Identifier: GPL-3.0-or-later
"""Points that the engine proposes: they count when they are accepted, and points by hand win."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from layouts import draw

from mgf_blender.prompts import files, preview, properties, suggest
from mgf_blender.prompts.drawing import ring_triangles
from mgf_blender.prompts.panel import MGF_PT_prompts
from mgf_blender.prompts.suggest import proposed
from mgf_blender.prompts.tool import nearest
from mgf_blender.scene_import.imported_scene import ImportedScene

CLICKS = {"positive": [[100.0, 80.0], [110.0, 85.0]], "negative": [[20.0, 150.0]]}


@pytest.fixture
def photos(house) -> list[str]:
    return sorted(house.poses)[:3]


@pytest.fixture
def state(addon, engine, house, photos):
    """An imported scene whose engine proposes points on three photos."""
    engine("ok", FAKE_PHOTOS="|".join(photos))
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    addon.job_folder = str(house.job)
    return addon


def arguments(house) -> list[str]:
    return json.loads((Path(f"{house.job}.suggested") / "arguments.json").read_text())


def test_proposed_points_do_not_count_until_they_are_accepted(state, house, photos):
    assert bpy.ops.mgf.suggest_clicks() == {"FINISHED"}
    scene = bpy.context.scene
    line = arguments(house)
    assert line[:2] == ["suggest-clicks", str(house.folder)] and line[line.index("--job") + 1] == str(house.job)
    assert "--cancel-on-eof" in line and "--point" not in line
    assert [photo.name for photo in proposed(scene)] == photos
    assert files.to_data(scene) == {} and not any(photo.done() for photo in scene.mgf.photos)
    assert scene.mgf.photos[scene.mgf.photo_index].name == photos[0]
    before = preview.signature(scene.mgf.photos[photos[0]])
    said = draw(MGF_PT_prompts).said
    assert "9 points proposed in 3 photos" in said and "Accept All" in said and "Suggest" in said
    assert bpy.ops.mgf.accept_suggestions(every=False) == {"FINISHED"}
    assert files.to_data(scene) == {photos[0]: CLICKS}
    assert preview.signature(scene.mgf.photos[photos[0]]) != before
    accept = [
        (given.every, on) for name, given, on in draw(MGF_PT_prompts).operators if name.endswith("accept_suggestions")
    ]
    assert accept == [(False, False), (True, True)]  # nothing is left to accept in this photo
    assert bpy.ops.mgf.accept_suggestions() == {"FINISHED"}
    assert files.to_data(scene) == dict.fromkeys(photos, CLICKS) and proposed(scene) == []
    assert "Points proposed in" not in draw(MGF_PT_prompts).said  # nor the warnings of that run
    with pytest.raises(RuntimeError, match="No points are proposed"):
        bpy.ops.mgf.accept_suggestions()


def test_the_photo_that_someone_works_on_stays(state):
    scene = bpy.context.scene
    name = scene.mgf.photos[-1].name
    scene.mgf.photo_index = len(scene.mgf.photos) - 1
    files.add_click(scene.mgf.photos[name], 1, 2, False, "building")
    bpy.ops.mgf.suggest_clicks()
    assert len(proposed(scene)) and properties.active_photo(scene).name == name


def test_a_photo_in_an_image_editor_stays_and_one_that_nobody_chose_does_not(state, monkeypatch):
    scene = bpy.context.scene
    at = len(scene.mgf.photos) - 1
    scene.mgf.photo_index = at
    name, image = scene.mgf.photos[at].name, properties.photo_image(scene.mgf.photos[at])
    area = SimpleNamespace(spaces=SimpleNamespace(active=SimpleNamespace(image=image)))
    monkeypatch.setattr(suggest, "areas_of", lambda kind: [(None, area)] if kind == "IMAGE_EDITOR" else [])
    bpy.ops.mgf.suggest_clicks()
    assert properties.active_photo(scene).name == name
    area.spaces.active.image = None
    bpy.ops.mgf.suggest_clicks()
    assert scene.mgf.photos[scene.mgf.photo_index] in proposed(scene)


def test_a_proposed_point_is_a_ring_through_which_the_photo_shows():
    """A disc and a ring of one size could hardly be told apart."""
    corners, triangles = map(np.array, ring_triangles(50.0, 40.0, 7.0, 11.0))
    distance = np.linalg.norm(corners - (50.0, 40.0), axis=1)
    assert distance.min() == pytest.approx(7) and distance.max() == pytest.approx(11)
    edges = corners[triangles]
    one, other = edges[:, 1] - edges[:, 0], edges[:, 2] - edges[:, 0]
    area = abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]).sum() / 2
    assert area == pytest.approx(np.pi * (11**2 - 7**2), rel=0.03)
    assert len(ring_triangles(0.0, 0.0, 0.0, 5.0)[0]) == len(corners)


def test_points_by_hand_win_and_the_rest_can_be_thrown_away(state, photos):
    scene = bpy.context.scene
    hand = scene.mgf.photos[0].name
    files.add_click(scene.mgf.photos[0], 1, 2, False, "building")
    bpy.ops.mgf.suggest_clicks()
    assert hand not in {photo.name for photo in proposed(scene)}
    bpy.ops.mgf.suggest_clicks()  # again: new proposals take the place of the old
    assert all(len(photo.clicks) == 3 for photo in proposed(scene)) and len(proposed(scene)) == len(
        set(photos) - {hand}
    )
    photo = proposed(scene)[0]
    photo.clicks.remove(nearest(photo, 20, 150, 5.0))  # as X does
    photo.clicks[nearest(photo, 101, 80, 5.0)].proposed = False  # as a drag does
    assert files.to_data(scene)[photo.name] == {"positive": [[100.0, 80.0]]} and photo in proposed(scene)
    kept = photo.name
    bpy.ops.mgf.discard_suggestions()
    assert files.to_data(scene) == {hand: {"positive": [[1.0, 2.0]]}, kept: {"positive": [[100.0, 80.0]]}}
    assert proposed(scene) == []


def test_proposals_survive_saving_and_one_undo_takes_them_back(state, tmp_path):
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.mgf.suggest_clicks()
    bpy.ops.ed.undo_push(message="after")
    assert len(proposed(bpy.context.scene)) == 3
    path = str(tmp_path / "a.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    assert len(proposed(bpy.context.scene)) == 3


def test_the_building_at_the_cursor_and_in_the_crop_box(state, house):
    scene, imported = bpy.context.scene, ImportedScene.find(bpy.context.scene)
    imported.root.matrix_world @= imported.root.matrix_world.Scale(2.0, 4)
    bpy.context.view_layer.update()
    local = np.array([0.5, -0.25, 1.0])
    scene.cursor.location = imported.root.matrix_world @ imported.root.matrix_world.to_translation().__class__(local)
    state.suggest_at = "CURSOR"
    bpy.ops.mgf.suggest_clicks()
    line = arguments(house)
    at = line.index("--point")
    assert [float(v) for v in line[at + 1 : at + 4]] == pytest.approx(local + imported.offset, abs=1e-5)
    bpy.ops.mgf.add_crop_box()
    bpy.ops.mgf.suggest_clicks()
    assert any(text.startswith("crop_box=") and len(text) > 20 for text in arguments(house))


@pytest.mark.parametrize(("mode", "match"), [("bad", "Nothing in the sparse points"), ("silent", "ended with code 77")])
def test_a_run_that_fails_says_why_and_leaves_the_points(state, engine, mode, match):
    bpy.ops.mgf.suggest_clicks()
    engine(mode)
    with pytest.raises(RuntimeError, match=match):
        bpy.ops.mgf.suggest_clicks()
    assert len(proposed(bpy.context.scene)) == 3
