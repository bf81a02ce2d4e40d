# SPDX-License-Identifier: GPL-3.0-or-later
"""The true mesh, rendered through Blender's cameras, covers the pixels that COLMAP's equations say."""

from __future__ import annotations

import importlib.util
import sys

import bpy
import numpy as np
import pytest
import synthetic
from conftest import REPO

from mgf_blender.results.load import import_result
from mgf_blender.scene_import.cameras import PHOTO_KEY
from mgf_blender.scene_import.load import import_scene


@pytest.fixture(scope="module")
def tool():
    spec = importlib.util.spec_from_file_location("measure_overlay", REPO / "tools" / "measure_overlay.py")
    module = importlib.util.module_from_spec(spec)
    path = list(sys.path)
    spec.loader.exec_module(module)
    sys.path[:] = path
    return module


def true_silhouette(pose: tuple) -> np.ndarray:
    """The house through one camera, by half-planes of its projected triangles; bool [H, W]."""
    number, rotation, translation = pose
    model, width, height, params = synthetic.CAMERAS[number]
    fx, fy, cx, cy = (params[0], *params[:3]) if "SIMPLE" in model else params[:4]
    xyz, faces, _ = synthetic.house_mesh()
    local = xyz @ synthetic._turn(0.7, -0.4).T @ rotation.T + translation
    uv = local[:, :2] / local[:, 2:] * (fx, fy) + (cx, cy)
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    covered = np.zeros((height, width), bool)
    for a, b, c in uv[faces]:
        sides = [(q[0] - p[0]) * (v - p[1]) - (q[1] - p[1]) * (u - p[0]) for p, q in ((a, b), (b, c), (c, a))]
        covered |= np.all([s >= 0 for s in sides], axis=0) | np.all([s <= 0 for s in sides], axis=0)
    return covered


def test_render_overlays_the_photo_for_every_kind_of_camera(scene, house, tool):
    imported = import_scene(scene, house.folder).imported
    import_result(scene, house.job, imported)
    for camera in imported.objects("Cameras")[:6]:  # one of each kind
        truth = true_silhouette(house.poses[camera[PHOTO_KEY]])
        render = tool.silhouette(scene, imported, camera)
        distances = tool.outline_distances(truth, render)
        assert truth.sum() > 500 and len(distances) > 20
        assert np.median(distances) == 0 and distances.max() <= 1.5, camera[PHOTO_KEY]
        assert (truth != render).mean() < 1e-3
    assert not any(o.hide_render for o in bpy.data.objects)


def test_the_measure_sees_a_shift(tool):
    mask = np.zeros((60, 80), bool)
    mask[20:40, 20:60] = True
    moved = np.roll(mask, 3, axis=1)
    distances = tool.outline_distances(mask, moved)
    assert distances.max() == 3 and 0 < np.mean(distances) < 3
    hidden = np.zeros_like(mask)
    hidden[:, :25] = True
    assert len(tool.outline_distances(mask, moved, hidden)) < len(distances)


def test_no_outline_in_the_render_is_infinitely_far(tool):
    mask = np.zeros((60, 80), bool)
    mask[20:40, 20:60] = True
    assert np.isinf(tool.outline_distances(mask, np.zeros_like(mask))).all()
    assert len(tool.outline_distances(np.zeros_like(mask), mask)) == 0


@pytest.mark.parametrize(("labels", "own", "building", "hidden"), [
    ((0, 255), False, 1, 0),  # a plain mask
    ((0, 255), True, 0, 1),  # a job's labels of a photo in which the building is hidden
    ((0, 3, 255), False, 1, 1),
])  # fmt: skip
def test_label_255_is_building_in_plain_masks_only(tool, tmp_path, labels, own, building, hidden):
    image = bpy.data.images.new("labels", len(labels), 1)
    image.colorspace_settings.name = "Non-Color"
    gray = np.array(labels, np.float32) / 255
    image.pixels.foreach_set(np.stack([gray, gray, gray, np.ones_like(gray)], axis=1).ravel())
    image.filepath_raw, image.file_format = str(tmp_path / "mask.png"), "PNG"
    image.save()
    bpy.data.images.remove(image)
    found = tool.read_mask(tmp_path / "mask.png", own)
    assert [int(part.sum()) for part in found] == [building, hidden]
