# SPDX-License-Identifier: GPL-3.0-or-later
"""Putting an imported scene right: camera, render size, scale, up axis."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest
import synthetic
from mathutils import Vector

from mgf_blender.scene_import.cameras import PHOTO_KEY
from mgf_blender.scene_import.tree import Tree


@pytest.fixture
def tree(addon, house):
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    return Tree.find(bpy.context.scene)


def render_size() -> tuple:
    render = bpy.context.scene.render
    return render.resolution_x, render.resolution_y, render.pixel_aspect_x, render.pixel_aspect_y


def test_every_way_to_name_the_model(addon, house):
    for path in (house.folder, house.model, house.model / "images.bin", house.model / "points3D.bin"):
        bpy.ops.mgf.import_colmap(filepath=str(path))
        assert len([c for c in bpy.data.collections if c.get("mgf_role") == "tree"]) == 1
        assert Path(addon.source).is_dir()
    bpy.ops.mgf.import_colmap(directory=str(house.folder) + "/", filepath=str(house.folder / "untitled"))
    with pytest.raises(RuntimeError, match="does not exist"):
        bpy.ops.mgf.import_colmap(filepath="/nowhere/at/all")
    with pytest.raises(RuntimeError, match="No model was chosen"):
        bpy.ops.mgf.import_colmap()


def test_bad_model_leaves_the_scene_alone(addon, house):
    (house.model / "points3D.bin").write_bytes(b"\1")
    with pytest.raises(RuntimeError, match="damaged or ends too early"):
        bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    assert not bpy.data.objects and not addon.source and len(bpy.context.scene.collection.children) == 0


def test_missing_photos_are_counted(addon, house, capfd):
    for path in list((house.folder / "images").rglob("*.png"))[:5]:
        path.unlink()
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    assert "5 of 12 photos were not found" in "".join(capfd.readouterr())
    assert len(Tree.find(bpy.context.scene).objects("Cameras")) == 12


def test_render_takes_the_size_of_each_camera(tree, house):
    seen = set()
    for _ in range(12):
        bpy.ops.mgf.look_through(step=1)
        name = bpy.context.scene.camera[PHOTO_KEY]
        _, width, height, _ = synthetic.CAMERAS[house.poses[name][0]]
        assert render_size()[:2] == (width, height)
        seen.add(name)
    assert seen == set(house.poses)


def test_render_follows_when_the_camera_changes_by_other_means(tree):
    other = next(o for o in tree.objects("Cameras") if tuple(o["mgf_size"]) == (400, 900))
    bpy.context.scene.camera = other
    bpy.context.view_layer.update()
    assert render_size()[:2] == (400, 900)
    bpy.context.scene.mgf.fit_render = False
    bpy.context.scene.camera = next(o for o in tree.objects("Cameras") if tuple(o["mgf_size"]) == (640, 480))
    bpy.context.view_layer.update()
    assert render_size()[:2] == (400, 900)


def test_scale_by_two_points(tree):
    cameras = tree.objects("Cameras")[:2]
    bpy.context.view_layer.update()
    for obj in bpy.context.view_layer.objects:
        obj.select_set(obj in cameras)
    before = [o.data.clip_end for o in cameras]
    measured = (cameras[0].matrix_world.translation - cameras[1].matrix_world.translation).length
    bpy.ops.mgf.set_scale(distance=3 * measured)
    bpy.context.view_layer.update()
    now = (cameras[0].matrix_world.translation - cameras[1].matrix_world.translation).length
    assert now == pytest.approx(3 * measured, rel=1e-5)
    assert cameras[0].data.clip_end == pytest.approx(3 * before[0], rel=1e-4)
    cameras[0].select_set(False)
    with pytest.raises(RuntimeError, match="exactly two"):
        bpy.ops.mgf.set_scale(distance=1.0)


def test_up_axis_by_hand_and_back(tree):
    root = tree.root
    upright = np.array(root.matrix_basis)[:3, :3]
    bpy.ops.mgf.set_up_axis(axis="NEG_Y")
    assert (root.matrix_basis.to_3x3() @ Vector((0, -1, 0)) - Vector((0, 0, 1))).length < 1e-5
    bpy.ops.mgf.set_up_axis(axis="CAMERAS")
    np.testing.assert_allclose(np.array(root.matrix_basis)[:3, :3], upright, atol=1e-4)


def test_drop_handler_knows_the_files():
    from mgf_blender.scene_import.operators import MGF_FH_colmap

    assert MGF_FH_colmap.bl_file_extensions == ".bin;.txt"
    assert MGF_FH_colmap.bl_import_operator == "mgf.import_colmap"
