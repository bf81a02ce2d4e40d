# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras that disagree with their points are adjusted, whatever lens and frame; sound models are left alone."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from benchmarks.synthetic.colmap_scene import Messages, reconstruction, write_model
from mgf_engine.errors import Cancelled
from mgf_engine.scene.adjust import AdjustOptions, adjust_if_inconsistent, far_points
from mgf_engine.scene.adjust_task import RESULT, TASK, AdjustmentTask, read_result, read_task, write_result, write_task
from mgf_engine.scene.adjust_worker import align_similarity, replaced_points
from mgf_engine.scene.colmap import read_model
from mgf_engine.scene.colmap_bundle import centres, projection_errors, transform_model
from mgf_engine.scene.normalise import rotation_of
from mgf_engine.scene.sparse import SparseModel

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


def median_error(model: SparseModel) -> float:
    return float(np.median(projection_errors(model, RESOLUTION)))


@pytest.mark.parametrize("lens", ["PINHOLE", "SIMPLE_RADIAL", "OPENCV", "OPENCV_FISHEYE"])
@pytest.mark.parametrize("wrong", ["focal", "poses"])
def test_a_model_that_contradicts_itself_is_mended(tmp_path: Path, lens: str, wrong: str) -> None:
    true, messages = true_model(tmp_path, lens), Messages()
    bad = zoomed(true, 1.08) if wrong == "focal" else turned(true, 0.02)
    assert median_error(true) < 1e-3 and median_error(bad) > 1.0
    mended = adjust_if_inconsistent(bad, RESOLUTION, messages.reporter)
    assert median_error(mended) < 0.05
    assert mended.cameras[1].params[0] == pytest.approx(true.cameras[1].params[0], rel=0.01)
    size = np.ptp(centres(true), axis=0).max()
    assert np.linalg.norm(centres(mended) - centres(true), axis=1).max() < 0.02 * size
    (text,) = messages.warnings
    assert "bundle adjustment reduced it" in text


def test_adjusting_can_be_switched_off(tmp_path: Path) -> None:
    bad, messages = turned(true_model(tmp_path), 0.02), Messages()
    assert adjust_if_inconsistent(bad, RESOLUTION, messages.reporter, AdjustOptions(adjust=False)) is bad
    assert messages.warnings == []


def test_coordinates_of_a_map_are_kept(tmp_path: Path) -> None:
    true = true_model(tmp_path, offset=1e6)
    mended = adjust_if_inconsistent(turned(true, 0.02), RESOLUTION, Messages().reporter)
    assert median_error(mended) < 0.05
    assert np.linalg.norm(centres(mended) - centres(true), axis=1).max() < 0.1


def test_sound_models_and_those_that_cannot_get_better_stay_as_they_are(tmp_path: Path) -> None:
    true, messages = true_model(tmp_path), Messages()
    assert adjust_if_inconsistent(true, RESOLUTION, messages.reporter) is true
    noisy = shaken(true, 2.0)
    assert median_error(noisy) > 1.0
    assert adjust_if_inconsistent(noisy, RESOLUTION, messages.reporter) is noisy
    assert messages.warnings == []


def test_stray_points_are_no_reason_to_move_cameras(tmp_path: Path) -> None:
    true = true_model(tmp_path)
    xyz = true.points.xyz.copy()
    xyz[::2] = np.random.default_rng(1).permutation(xyz[::2])
    bad = replace(true, points=replace(true.points, xyz=xyz))
    assert adjust_if_inconsistent(bad, RESOLUTION, Messages().reporter) is bad


def test_numbers_beyond_reason_leave_the_model_as_it_is(tmp_path: Path) -> None:
    true = true_model(tmp_path)
    far = replace(true, points=replace(true.points, xyz=true.points.xyz * 1e14))
    flat = replace(true, images=tuple(replace(i, translation=i.translation * 0.0) for i in true.images))
    broken = replace(true, cameras={i: replace(c, params=(0.0,) * len(c.params)) for i, c in true.cameras.items()})
    for model in (far, flat, broken):
        result = adjust_if_inconsistent(model, RESOLUTION, Messages().reporter)
        assert np.isfinite(result.points.xyz).all()
    assert adjust_if_inconsistent(broken, RESOLUTION, Messages().reporter) is broken


def test_points_are_placed_where_the_rays_meet(tmp_path: Path) -> None:
    true = true_model(tmp_path, "OPENCV")
    lost = np.random.default_rng(2).normal(0, 3, true.points.xyz.shape)
    placed = replaced_points(replace(true, points=replace(true.points, xyz=lost)), RESOLUTION, 0.5)
    assert np.abs(placed.points.xyz - true.points.xyz).max() < 1e-3


def test_wrong_observations_and_stray_points_do_not_bend_the_cameras(tmp_path: Path) -> None:
    true, rng = true_model(tmp_path, "OPENCV"), np.random.default_rng(3)
    bad = shaken(turned(true, 0.02), 0.3)
    images = []
    for image in bad.images:
        keypoints, wrong = image.keypoints.copy(), rng.random(len(image.keypoints)) < 0.1
        keypoints[wrong] = rng.uniform(0, 120, (wrong.sum(), 2))
        images.append(replace(image, keypoints=keypoints))
    xyz = bad.points.xyz.copy()
    xyz[::4] = rng.permutation(xyz[::4])
    bad = replace(bad, images=tuple(images), points=replace(bad.points, xyz=xyz))
    mended = adjust_if_inconsistent(bad, RESOLUTION, Messages().reporter)
    assert median_error(bad) > 2.0 and median_error(mended) < 0.4
    assert mended.cameras[1].params[0] == pytest.approx(true.cameras[1].params[0], rel=0.01)
    size = np.ptp(centres(true), axis=0).max()
    assert np.linalg.norm(centres(mended) - centres(true), axis=1).max() < 0.01 * size
    assert np.median(np.linalg.norm(mended.points.xyz - true.points.xyz, axis=1)) < 0.005 * size


def test_errors_are_those_of_the_working_photos(tmp_path: Path) -> None:
    true = true_model(tmp_path)
    aside = np.array([3.0, 4.0])
    away = replace(true, images=tuple(replace(i, keypoints=i.keypoints + aside) for i in true.images))
    assert np.allclose(projection_errors(away, RESOLUTION), 5.0, atol=1e-6)
    assert np.allclose(projection_errors(away, RESOLUTION // 2), 2.5, atol=1e-6)
    forward = np.array([rotation_of(image.quaternion)[2] for image in true.images])
    back = np.full_like(true.points.xyz, (centres(true)[0] - 10 * forward[0]))
    behind = projection_errors(replace(true, points=replace(true.points, xyz=back)), RESOLUTION)
    assert np.isinf(behind[true.points.image_ids == true.images[0].id]).all()


def test_the_same_model_is_always_adjusted_alike_and_nothing_is_printed(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    bad = shaken(turned(true_model(tmp_path), 0.02), 0.3)
    first, second = (adjust_if_inconsistent(bad, RESOLUTION, Messages().reporter) for _ in range(2))
    assert first is not bad
    assert np.array_equal(first.points.xyz, second.points.xyz)
    assert np.array_equal(centres(first), centres(second)) and first.cameras == second.cameras
    assert capfd.readouterr() == ("", "")


def test_a_crash_of_the_process_leaves_the_model_and_cancelling_ends_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bad = turned(true_model(tmp_path), 0.02)
    messages = Messages()
    messages.reporter.cancel()
    with pytest.raises(Cancelled):
        adjust_if_inconsistent(bad, RESOLUTION, messages.reporter)
    crash = tmp_path / "crash.py"
    crash.write_text("import os; os.abort()")
    monkeypatch.setattr("mgf_engine.scene.adjust.COMMAND", (sys.executable, str(crash)))
    assert adjust_if_inconsistent(bad, RESOLUTION, Messages().reporter) is bad


def test_models_are_laid_onto_where_most_of_them_lay(tmp_path: Path) -> None:
    true = true_model(tmp_path)
    away = transform_model(
        true, pycolmap.Sim3d(2.5, pycolmap.Rotation3d(np.array([0.3, -0.2, 1.0])), np.array([1.0, 2.0, 3.0]))
    )
    assert median_error(away) < 1e-3
    xyz = away.points.xyz.copy()
    xyz[::3] += np.random.default_rng(6).normal(0, 5, xyz[::3].shape)
    used = np.arange(len(xyz))
    task = AdjustmentTask(true, RESOLUTION, used, used, 1.0)
    back = align_similarity(replace(away, points=replace(away.points, xyz=xyz)), task)
    assert back is not None and np.allclose(centres(back), centres(true), atol=1e-6)
    nowhere = replace(
        away,
        images=tuple(replace(i, translation=np.full(3, np.nan)) for i in away.images),
        points=replace(away.points, xyz=np.full_like(xyz, np.nan)),
    )
    assert align_similarity(nowhere, task) is None


def test_far_points_are_counted() -> None:
    start = np.array([0, 3, 6, 6])
    assert far_points(np.array([0.1, 0.2, 9.0, 9.0, 9.0, 0.1]), start).tolist() == [False, True, False]
    assert far_points(np.zeros(0), np.zeros(3, np.int64)).tolist() == [False, False]


def test_a_task_and_its_result_pass_through_plain_files(tmp_path: Path) -> None:
    model = true_model(tmp_path, "OPENCV")
    chosen = np.arange(4)
    write_task(AdjustmentTask(model, 750, chosen, chosen[:2], 3.5), tmp_path / TASK)
    task = read_task(tmp_path / TASK)
    assert (task.resolution, task.before) == (750, 3.5)
    assert task.chosen.tolist() == [0, 1, 2, 3] and task.used.tolist() == [0, 1]
    assert task.model.cameras == model.cameras
    for got, sent in zip(task.model.images, model.images, strict=True):
        assert (got.id, got.name, got.camera_id) == (sent.id, sent.name, sent.camera_id)
        for name in ("quaternion", "translation", "keypoints", "point_ids"):
            assert np.array_equal(getattr(got, name), getattr(sent, name))
    for name, value in vars(model.points).items():
        assert np.array_equal(getattr(task.model.points, name), value)
    changed = replace(model, points=replace(model.points, xyz=model.points.xyz + 1))
    write_result(changed, tmp_path / RESULT)
    assert np.array_equal(read_result(tmp_path / RESULT, model).points.xyz, changed.points.xyz)
