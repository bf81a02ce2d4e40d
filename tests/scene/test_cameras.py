# SPDX-License-Identifier: GPL-3.0-or-later
"""Every camera model becomes a pinhole camera: keypoints, photos, clicks and masks land where they belong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap
import pytest

from benchmarks.synthetic.colmap_scene import (
    FOCAL,
    LENSES,
    SIZE,
    color_of_rays,
    load,
    photo_of,
    reconstruction,
    reprojection,
    write_scene,
)
from mgf_engine.errors import BadInput
from mgf_engine.scene.cameras import from_original, plan_camera, to_original, warp_labels
from mgf_engine.scene.sparse import SparseCamera


def test_every_planar_model_of_colmap_is_tested() -> None:
    known = set(pycolmap.CameraModelId.__members__) - {"INVALID", "EQUIRECTANGULAR"}
    assert known == set(LENSES)


@pytest.mark.parametrize("model", sorted(LENSES))
@pytest.mark.parametrize("resolution", [100, 750])
def test_keypoints_meet_projections(model: str, resolution: int, tmp_path: Path) -> None:
    source = write_scene(reconstruction(model, frames=4), tmp_path / "scene")
    scene = load(source, tmp_path / "job", resolution=resolution)
    errors = reprojection(scene)
    assert len(errors) > 0.5 * 4 * 60  # the crop of strong lenses may lose some
    # float32 pixels and COLMAP's iterative undistortion: to a hundredth of a pixel, not to the bit.
    assert errors.max() < 0.01
    for view in scene.views:
        assert max(view.width, view.height) <= resolution
        assert (view.lens is None) == (model in ("PINHOLE", "SIMPLE_PINHOLE"))


@pytest.mark.parametrize("model", sorted(LENSES))
def test_working_photos_show_the_rays_of_their_pinhole(model: str, tmp_path: Path) -> None:
    camera = SparseCamera(1, model, *SIZE, tuple(LENSES[model]))
    working = plan_camera(camera, (2 * SIZE[0], 2 * SIZE[1]), SIZE[0])
    original = pycolmap.Camera(model=model, width=SIZE[0], height=SIZE[1], params=LENSES[model])
    photo = working.make_photo(photo_of(original, (2 * SIZE[0], 2 * SIZE[1])))
    assert photo.shape == (working.height, working.width, 3)
    x, y = np.meshgrid(np.arange(working.width) + 0.5, np.arange(working.height) + 0.5)
    rays = np.stack([(x.ravel() - working.cx) / working.fx, (y.ravel() - working.cy) / working.fy], 1)
    difference = np.abs(photo.reshape(-1, 3) - color_of_rays(rays))
    # A shift by half a pixel changes colours by up to 1 (300 grey levels per unit of ray, 150 px); resampling
    # rounds twice.
    assert difference.mean() < 0.6
    assert difference.max() < 3.0


@pytest.mark.parametrize("model", ["PINHOLE", "OPENCV", "OPENCV_FISHEYE"])
def test_clicks_go_there_and_back(model: str, tmp_path: Path) -> None:
    scene = load(write_scene(reconstruction(model, frames=3), tmp_path / "scene"), tmp_path / "job", resolution=100)
    view = scene.views[0]
    working = np.random.default_rng(0).random((50, 2)) * (view.width, view.height)
    original = to_original(view, working)
    assert (original > -1).all() and (original < np.array(SIZE) + 1).all()
    assert np.abs(from_original(view, original) - working).max() < 1e-3


def test_masks_are_warped_like_photos(tmp_path: Path) -> None:
    model = reconstruction("OPENCV", frames=3)
    scene = load(write_scene(model, tmp_path / "scene"), tmp_path / "job", resolution=120)
    photo = photo_of(model.cameras[1], (4 * SIZE[0], 4 * SIZE[1]))
    labels = (photo[:, :, 2] > 128).astype(np.uint8)
    view = scene.views[0]
    warped = warp_labels(view, labels)
    expected = scene.photo(0)[:, :, 2] > 128
    assert warped.shape == (view.height, view.width)
    assert (warped.astype(bool) != expected).mean() < 0.02  # only along the edges


@pytest.mark.parametrize("distortion", [-2.0, -40.0])
def test_a_lens_that_cannot_be_straightened_is_refused(distortion: float) -> None:
    camera = SparseCamera(1, "SIMPLE_RADIAL", *SIZE, (FOCAL, 80.0, 60.0, distortion))
    with pytest.raises(BadInput, match="undistort"):
        plan_camera(camera, SIZE, 100)


def test_small_photos_are_not_enlarged() -> None:
    working = plan_camera(SparseCamera(1, "PINHOLE", 6000, 4000, (5000.0, 5000.0, 3000.0, 2000.0)), (300, 200), 750)
    assert (working.width, working.height, working.fx, working.cx) == (300, 200, 250.0, 150.0)
