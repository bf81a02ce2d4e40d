# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras that disagree with their points are adjusted, whatever lens and frame; sound models are left alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from mgf_engine.scene.adjust import agreeing, bundle_of, far_points, similarity
from mgf_engine.scene.bundle import Bundle, adjust, errors, triangulate
from mgf_engine.scene.colmap import read_model
from mgf_engine.scene.normalise import rotation_of
from mgf_engine.scene.sparse import SparseModel
from scene.synthetic import Messages, reconstruction, write_model

RESOLUTION = 160  # of photos that are 160 wide: errors are in their own pixels


def true_model(folder: Path, lens: str = "PINHOLE", offset: float = 0.0) -> SparseModel:
    model = reconstruction(lens, frames=8, points=200)
    model.transform(pycolmap.Sim3d(1.0, pycolmap.Rotation3d(), np.array([offset, 5 * offset, 0.0])))
    return read_model(write_model(model, folder))


def zoomed(model: SparseModel, factor: float) -> SparseModel:
    """Every focal length multiplied, poses and points as they were."""
    cameras = {}
    for i, camera in model.cameras.items():
        params = np.array(camera.params)
        known = pycolmap.Camera(model=camera.model, width=camera.width, height=camera.height, params=params)
        params[list(known.focal_length_idxs())] *= factor
        cameras[i] = replace(camera, params=tuple(params.tolist()))
    return replace(model, cameras=cameras)


def turned(model: SparseModel, sigma: float) -> SparseModel:
    """Every camera turned on the spot by about ``sigma`` radians."""
    rng, images = np.random.default_rng(4), []
    for image in model.images:
        turn = pycolmap.Rotation3d(rng.normal(0, sigma, 3)).matrix()
        quaternion = np.roll(pycolmap.Rotation3d(turn @ rotation_of(image.quaternion)).quat, 1)
        images.append(replace(image, quaternion=quaternion, translation=turn @ image.translation))
    return replace(model, images=tuple(images))


def shaken(model: SparseModel, pixels: float) -> SparseModel:
    """Keypoints that no camera could explain."""
    rng = np.random.default_rng(5)
    images = (replace(i, keypoints=i.keypoints + rng.normal(0, pixels, i.keypoints.shape)) for i in model.images)
    return replace(model, images=tuple(images))


def centres(model: SparseModel) -> np.ndarray:
    return np.array([-rotation_of(i.quaternion).T @ i.translation for i in model.images])


def median_error(model: SparseModel) -> float:
    return float(np.median(errors(bundle_of(model, RESOLUTION))))


@pytest.mark.parametrize("lens", ["PINHOLE", "SIMPLE_RADIAL", "OPENCV", "OPENCV_FISHEYE"])
@pytest.mark.parametrize("wrong", ["focal", "poses"])
def test_a_model_that_contradicts_itself_is_mended(tmp_path: Path, lens: str, wrong: str) -> None:
    true, messages = true_model(tmp_path, lens), Messages()
    bad = zoomed(true, 1.08) if wrong == "focal" else turned(true, 0.02)
    assert median_error(true) < 1e-3 and median_error(bad) > 1.0
    mended = agreeing(bad, RESOLUTION, messages.reporter)
    assert median_error(mended) < 0.05
    assert mended.cameras[1].params[0] == pytest.approx(true.cameras[1].params[0], rel=0.01)
    size = np.ptp(centres(true), axis=0).max()
    assert np.linalg.norm(centres(mended) - centres(true), axis=1).max() < 0.02 * size
    (text,) = messages.warnings
    assert "disagreed by" in text and "were adjusted" in text


def test_coordinates_of_a_map_are_kept(tmp_path: Path) -> None:
    true = true_model(tmp_path, offset=1e6)
    mended = agreeing(turned(true, 0.02), RESOLUTION, Messages().reporter)
    assert median_error(mended) < 0.05
    assert np.linalg.norm(centres(mended) - centres(true), axis=1).max() < 0.1


def test_sound_models_and_those_that_cannot_get_better_stay_as_they_are(tmp_path: Path) -> None:
    true, messages = true_model(tmp_path), Messages()
    assert agreeing(true, RESOLUTION, messages.reporter) is true
    noisy = shaken(true, 2.0)
    assert median_error(noisy) > 1.0
    assert agreeing(noisy, RESOLUTION, messages.reporter) is noisy
    assert messages.warnings == []


def test_stray_points_are_no_reason_to_move_cameras(tmp_path: Path) -> None:
    true = true_model(tmp_path)
    xyz = true.points.xyz.copy()
    xyz[::2] = np.random.default_rng(1).permutation(xyz[::2])
    bad = replace(true, points=replace(true.points, xyz=xyz))
    assert agreeing(bad, RESOLUTION, Messages().reporter) is bad


def test_numbers_beyond_reason_leave_the_model_as_it_is(tmp_path: Path) -> None:
    true = true_model(tmp_path)
    far = replace(true, points=replace(true.points, xyz=true.points.xyz * 1e14))
    flat = replace(true, images=tuple(replace(i, translation=i.translation * 0.0) for i in true.images))
    broken = replace(true, cameras={i: replace(c, params=(0.0,) * len(c.params)) for i, c in true.cameras.items()})
    for model in (far, flat, broken):
        result = agreeing(model, RESOLUTION, Messages().reporter)
        assert np.isfinite(result.points.xyz).all()
    assert agreeing(broken, RESOLUTION, Messages().reporter) is broken


def test_points_are_placed_where_the_rays_meet(tmp_path: Path) -> None:
    bundle = bundle_of(true_model(tmp_path), RESOLUTION)
    lost = replace(bundle, points=np.random.default_rng(2).normal(0, 3, bundle.points.shape))
    assert np.abs(triangulate(lost).points - bundle.points).max() < 1e-3


def test_adjusting_never_makes_it_worse(tmp_path: Path) -> None:
    start = bundle_of(shaken(turned(true_model(tmp_path), 0.01), 0.5), RESOLUTION)

    def cost(bundle: Bundle) -> float:
        return float(np.median(errors(bundle)))

    assert cost(adjust(start, np.arange(len(start.view)))) < 0.5 * cost(start)


def test_similarities_are_found_and_far_points_counted() -> None:
    rng = np.random.default_rng(6)
    source = rng.normal(size=(20, 3))
    rotation = pycolmap.Rotation3d(np.array([0.3, -0.2, 1.0])).matrix()
    scale, found, offset = similarity(source, 2.5 * source @ rotation.T + [1.0, 2.0, 3.0], np.ones(20))
    assert scale == pytest.approx(2.5)
    assert np.allclose(found, rotation) and np.allclose(offset, [1, 2, 3])
    start = np.array([0, 3, 6, 6])
    assert far_points(np.array([0.1, 0.2, 9.0, 9.0, 9.0, 0.1]), start).tolist() == [False, True, False]
    assert far_points(np.zeros(0), np.zeros(3, np.int64)).tolist() == [False, False]
