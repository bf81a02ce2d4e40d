# SPDX-License-Identifier: GPL-3.0-or-later
"""Sparse points seen through Blender's cameras land where COLMAP puts them."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import bpy
import numpy as np
import pytest
import synthetic
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

from mgf_blender.scene_import.cameras import PHOTO_KEY, fit_render
from mgf_blender.scene_import.colmap import read_model
from mgf_blender.scene_import.exif import orientation_lacking
from mgf_blender.scene_import.load import import_scene
from mgf_blender.scene_import.locate import find_model

TOLERANCE = 0.01  # pixels; Blender keeps matrices in float32
DATA = Path(os.environ.get("MGF_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
SETS = ("south-building", "model-house", "strecha-herzjesu-p25", "strecha-fountain-p11", "strecha-entry-p10",
        "dtu-scan24", "sceaux-castle")  # fmt: skip


def worst_error(scene: bpy.types.Scene, folder: Path, every: int = 1) -> float:
    """Largest distance in pixels between Blender's and COLMAP's projection, over all cameras."""
    done = import_scene(scene, folder)
    model = read_model(find_model(folder))
    cameras = {o[PHOTO_KEY]: o for o in done.imported.objects("Cameras")}
    points = done.imported.objects("Points")[0]
    bpy.context.view_layer.update()
    local = np.empty(3 * len(points.data.vertices), np.float32)
    points.data.vertices.foreach_get("co", local)
    world = [points.matrix_world @ Vector(p) for p in local.reshape(-1, 3)[::every].tolist()]
    worst = 0.0
    for photo in model.photos:
        camera, obj = photo.camera, cameras[photo.name]
        fit_render(scene, obj)
        depth = model.points.xyz[::every] @ photo.rotation.T + photo.translation
        uv = depth[:, :2] / depth[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
        inside = (depth[:, 2] > 0) & (uv > 0).all(axis=1) & (uv < (camera.width, camera.height)).all(axis=1)
        for i in np.flatnonzero(inside):
            view = world_to_camera_view(scene, obj, world[i])
            pixel = (view.x * camera.width, (1 - view.y) * camera.height)
            worst = max(worst, float(np.hypot(*(uv[i] - pixel))))
    return worst


@pytest.mark.parametrize("text", [False, True], ids=["bin", "txt"])
def test_every_kind_of_camera_is_exact(scene, tmp_path, text):
    house = synthetic.write_house(tmp_path / "house", text=text)
    assert 0 < worst_error(scene, house.folder) < TOLERANCE


def test_far_from_the_origin_stays_exact(scene, tmp_path):
    house = synthetic.write_house(tmp_path / "utm", shift=(389_123.25, 5_712_345.75, 120.0))
    assert 0 < worst_error(scene, house.folder) < TOLERANCE


@pytest.mark.parametrize("name", SETS)
def test_real_sets_are_exact(scene, name):
    if not (DATA / name).is_dir():
        pytest.skip(f"the photo set {name} is not on this machine (MGF_DATA names the folder of the sets)")
    every = max(1, len(read_model(find_model(DATA / name)).points.xyz) // 400)
    assert 0 < worst_error(scene, DATA / name, every) < TOLERANCE


def test_upright_scene_stands_on_the_ground(scene, house):
    done = import_scene(scene, house.folder)
    bpy.context.view_layer.update()
    root = done.imported.root
    up = np.array(root.matrix_world)[:3, :3] @ synthetic._turn(0.7, -0.4) @ (0, 0, 1)
    assert up[2] > np.cos(np.radians(1.0))


def jpeg(orientation: int, width: int, height: int, order: str = ">") -> bytes:
    """The header of a JPEG with an EXIF orientation, as phones write it."""
    mark, pack = (b"MM\0*" if order == ">" else b"II*\0"), lambda form, *values: struct.pack(order + form, *values)
    entry = pack("HHIHH", 0x0112, 3, 1, orientation, 0)
    other = pack("HHII", 0x010F, 2, 4, 0)
    exif = b"Exif\0\0" + mark + pack("I", 8) + pack("H", 2) + other + entry + pack("I", 0)
    segments = ((0xE0, b"JFIF\0"), (0xE1, exif), (0xC0, struct.pack(">BHHB", 8, height, width, 3)))
    return b"\xff\xd8" + b"".join(struct.pack(">BBH", 255, m, len(b) + 2) + b for m, b in segments) + b"\xff\xda"


def test_the_header_tells_how_a_camera_was_held(tmp_path):
    photo = tmp_path / "a.JPG"
    for order in "<>":
        for orientation in (1, 3, 6, 8):
            photo.write_bytes(jpeg(orientation, 40, 30, order))
            assert orientation_lacking(photo, (400, 300)) == orientation
    assert orientation_lacking(photo, (300, 400)) == 1  # the camera saw the turned photo
    whole = photo.read_bytes()
    for length in range(len(whole)):
        photo.write_bytes(whole[:length])
        assert orientation_lacking(photo, (400, 300)) in (1, 8)
    for path in (tmp_path / "none.jpg", tmp_path / "b.png", None):
        assert orientation_lacking(path, (400, 300)) == 1


@pytest.mark.parametrize(("orientation", "turns"), [(3, 2), (6, 1), (8, 3)])
def test_photos_of_a_turned_camera_stand_upright(addon, scene, tmp_path, orientation, turns):
    """Phones store what the sensor saw; the scene lay on its side."""
    house = synthetic.write_house(tmp_path / "house")
    turn = np.linalg.matrix_power(np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]), turns)
    poses = {}
    for name, (camera, rotation, translation) in house.poses.items():
        poses[name.replace(".png", ".jpg")] = (camera, turn @ rotation, turn @ translation)
        _, width, height, _ = synthetic.CAMERAS[camera]
        (house.folder / "images" / name).with_suffix(".jpg").write_bytes(jpeg(orientation, width, height))
    synthetic.write_binary(house.model, poses, house.xyz, house.rgb)
    root = import_scene(scene, house.folder).imported.root
    for _ in range(2):
        bpy.context.view_layer.update()
        assert (np.array(root.matrix_world)[:3, :3] @ synthetic._turn(0.7, -0.4) @ (0, 0, 1))[2] > 0.999
        bpy.ops.mgf.set_up_axis(axis="X")
        bpy.ops.mgf.set_up_axis(axis="CAMERAS")


def test_keeps_axes_when_asked(scene, house):
    done = import_scene(scene, house.folder, upright=False)
    assert np.allclose(done.imported.root.matrix_basis, np.eye(4))


def test_photos_stand_behind_their_cameras(scene, house):
    done = import_scene(scene, house.folder)
    for obj in done.imported.objects("Cameras"):
        slot = obj.data.background_images[0]
        assert Path(slot.image.filepath_from_user()).is_file()
        assert tuple(slot.image.size) == tuple(obj["mgf_size"])


def test_points_carry_color_and_track_length(scene, house):
    mesh = import_scene(scene, house.folder).imported.objects("Points")[0].data
    n = len(mesh.vertices)
    color = np.empty(4 * n, np.float32)
    mesh.attributes["Color"].data.foreach_get("color_srgb", color)
    assert np.abs(color.reshape(-1, 4)[:, :3] * 255 - house.rgb).max() < 0.51
    length = np.empty(n, np.int32)
    mesh.attributes["track_length"].data.foreach_get("value", length)
    assert set(length) == {2}


def test_import_again_replaces_only_its_own(scene, house):
    imported = import_scene(scene, house.folder).imported
    mine = bpy.data.objects.new("Mine", None)
    imported.child("Cameras").objects.link(mine)
    imported.root.scale = (2, 2, 2)
    before = len(bpy.data.cameras), len(bpy.data.meshes), len(bpy.data.images), len(bpy.data.node_groups)
    again = import_scene(scene, house.folder, imported=imported)
    assert again.imported.root.scale[0] == 2
    assert mine.name in imported.child("Cameras").objects
    assert before == (len(bpy.data.cameras), len(bpy.data.meshes), len(bpy.data.images), len(bpy.data.node_groups))
