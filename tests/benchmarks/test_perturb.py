# SPDX-License-Identifier: GPL-3.0-or-later
"""Each perturbation does what it says, by the amount it says, and leaves everything else alone."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest

from benchmarks.perturb import PERTURBATIONS, RECORD, perturb
from benchmarks.perturb_photos import line_kernel
from benchmarks.synthetic.house_scene import PHOTOS, WALL, WINDOW, house_scene
from mgf_engine.errors import BadInput
from mgf_engine.scene.colmap import find_model, find_photos, read_model

WIDTH = 240  # of the photos; levels in pixels are given for 480


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return house_scene(tmp_path_factory)


def made(source: Path, tmp_path: Path, name: str, level: float, **more: object) -> Path:
    return perturb(source, tmp_path / "copy", name, level, **more)  # type: ignore[arg-type]


def model_of(folder: Path) -> pycolmap.Reconstruction:
    return pycolmap.Reconstruction(folder / "sparse/0")


def photos_of(folder: Path) -> dict[str, np.ndarray]:
    return {p.name: cv2.imread(str(p)).astype(float) for p in sorted((folder / "images").iterdir())}


def masks_of(folder: Path) -> dict[str, np.ndarray]:
    return {p.name: cv2.imread(str(p), cv2.IMREAD_UNCHANGED) > 0 for p in sorted((folder / "masks").iterdir())}


def centres(model: pycolmap.Reconstruction) -> np.ndarray:
    return np.array([i.projection_center() for i in sorted(model.images.values(), key=lambda i: i.name)])


@pytest.mark.parametrize("name", PERTURBATIONS)
def test_the_first_level_leaves_the_scene_as_it_is(source: Path, tmp_path: Path, name: str) -> None:
    folder = made(source, tmp_path, name, PERTURBATIONS[name].levels[0])
    for part in ("sparse/0/images.bin", "prompts.json", "images/photo_03.png", "masks/photo_03.png"):
        assert (folder / part).read_bytes() == (source / part).read_bytes()


@pytest.mark.parametrize("name", PERTURBATIONS)
def test_every_level_is_a_scene_the_engine_can_read_and_repeats_itself(source: Path, tmp_path: Path, name: str) -> None:
    level = PERTURBATIONS[name].levels[-1]
    first = made(source, tmp_path / "a", name, level)
    again = made(source, tmp_path / "b", name, level)
    assert find_model(first) == first / "sparse/0"
    model = read_model(first / "sparse/0")
    names = [image.name for image in model.images]
    assert find_photos(names, first / "sparse/0", first) == [first / "images" / name for name in names]
    assert set(json.loads((first / "prompts.json").read_text())) <= set(names)
    for path in sorted(p for p in first.rglob("*") if p.is_file()):
        assert path.read_bytes() == (again / path.relative_to(first)).read_bytes(), path
    assert json.loads((first / RECORD).read_text())["level"] == level


def test_photos_that_are_left_are_spread_and_clicked_on(source: Path, tmp_path: Path) -> None:
    folder = made(source, tmp_path, "photos", 4)
    assert len(photos_of(folder)) == len(masks_of(folder)) == model_of(folder).num_reg_images() == 4
    around = centres(model_of(folder)) - centres(model_of(source)).mean(0)
    angles = np.sort(np.degrees(np.arctan2(around[:, 1], around[:, 0])))
    assert np.diff(np.r_[angles, angles[0] + 360]).max() < 150
    clicks = json.loads((folder / "prompts.json").read_text())
    assert len(clicks) == 3
    for name, entry in clicks.items():
        mask = masks_of(source)[name]
        assert all(mask[int(v), int(u)] for u, v in entry["positive"])


def test_one_side_is_a_sector(source: Path, tmp_path: Path) -> None:
    folder = made(source, tmp_path, "side", 100)
    points = np.array([p.xyz for p in model_of(source).points3D.values()])
    away = centres(model_of(folder)) - np.median(points, axis=0)
    angles = np.degrees(np.unwrap(np.arctan2(away[:, 1], away[:, 0])))
    assert 3 <= len(angles) < PHOTOS
    assert np.ptp(angles) <= 101


def test_noise_is_as_strong_as_asked(source: Path, tmp_path: Path) -> None:
    folder = made(source, tmp_path, "noise", 10)
    before, after = photos_of(source), photos_of(folder)
    middle = np.concatenate([(after[n] - before[n])[(before[n] > 100) & (before[n] < 150)] for n in before])
    assert abs(middle.std() - 10) < 1.0
    assert abs(middle.mean()) < 0.2


@pytest.mark.parametrize(("name", "fixed"), [("exposure", None), ("white_balance", 1)])
def test_gains_differ_between_photos_and_stay_in_their_range(
    source: Path, tmp_path: Path, name: str, fixed: int | None
) -> None:
    folder = made(source, tmp_path, name, 1.0)
    before, after = photos_of(source), photos_of(folder)
    gains = []
    for photo in before:
        usable = (before[photo] > 60).all(2) & (after[photo] < 250).all(2)
        gains.append(np.median(after[photo][usable] / before[photo][usable], axis=0))
    stops = np.log2(np.array(gains)) * 2.2
    assert np.abs(stops).max() < 1.05
    assert stops[:, 0].std() > 0.2
    if fixed is None:
        assert np.ptp(stops, axis=1).max() < 0.1  # all channels alike
    else:
        assert np.abs(stops[:, fixed]).max() < 0.05


def test_the_blur_is_a_line_of_its_length(source: Path, tmp_path: Path) -> None:
    kernel = line_kernel(9.0, 0.3)
    y, x = np.mgrid[: kernel.shape[0], : kernel.shape[1]] - kernel.shape[0] // 2
    along = (kernel * (x * np.cos(0.3) + y * np.sin(0.3)) ** 2).sum()
    across = (kernel * (-x * np.sin(0.3) + y * np.cos(0.3)) ** 2).sum()
    assert abs(np.sqrt(12 * along) - 9.0) < 0.5  # a line of length L has the variance L^2 / 12
    assert across < 0.3
    assert abs(kernel.sum() - 1) < 1e-6
    folder = made(source, tmp_path, "blur", 12)
    before, after = photos_of(source), photos_of(folder)
    for name in before:
        assert cv2.Laplacian(after[name], cv2.CV_64F).std() < 0.7 * cv2.Laplacian(before[name], cv2.CV_64F).std()
        assert abs(after[name].mean() - before[name].mean()) < 2.0


def elements_of(folder: Path) -> dict[str, np.ndarray]:
    return {p.name: cv2.imread(str(p), cv2.IMREAD_UNCHANGED) for p in sorted((folder / "elements").iterdir())}


def test_plain_walls_have_one_color_and_few_points(source: Path, tmp_path: Path) -> None:
    folder = made(source, tmp_path, "walls", 1.0)
    before, after, elements = photos_of(source), photos_of(folder), elements_of(source)
    for name, map_ in elements.items():
        assert after[name][map_ == WALL].std(0).max() < 0.5 < before[name][map_ == WALL].std(0).min()
        assert (after[name][map_ == 0] == before[name][map_ == 0]).all()
    left = model_of(folder).num_points3D()
    assert 0 < left < 0.7 * model_of(source).num_points3D()
    half = made(source, tmp_path / "half", "walls", 0.5)
    assert left < model_of(half).num_points3D() < model_of(source).num_points3D()


def test_mirroring_windows_show_something_else_in_every_photo(source: Path, tmp_path: Path) -> None:
    folder = made(source, tmp_path, "mirrors", 1.0)
    before, after, elements = photos_of(source), photos_of(folder), elements_of(source)
    for name, map_ in elements.items():
        assert np.abs(after[name] - before[name])[map_ == WINDOW].mean() > 5
        assert (after[name][map_ != WINDOW] == before[name][map_ != WINDOW]).all()


def test_a_scene_without_elements_is_refused(source: Path, tmp_path: Path) -> None:
    shutil.copytree(source, tmp_path / "bare", ignore=shutil.ignore_patterns("elements"))
    with pytest.raises(BadInput, match="map of elements"):
        perturb(tmp_path / "bare", tmp_path / "copy", "walls", 1.0)


def test_shadows_darken_a_band_elsewhere_in_every_photo(source: Path, tmp_path: Path) -> None:
    folder = made(source, tmp_path, "shadows", 0.6)
    before, after = photos_of(source), photos_of(folder)
    bands = []
    for name in before:
        darker = after[name].sum(2) < 0.7 * before[name].sum(2)
        assert 0.05 < darker.mean() < 0.6
        untouched = ~cv2.dilate((after[name] < before[name] - 3).any(2).astype(np.uint8), np.ones((5, 5))).astype(bool)
        assert untouched.mean() > 0.2
        bands.append(darker)
    assert (bands[0] != bands[1]).mean() > 0.05


@pytest.mark.parametrize("foreign_scene", [False, True])
def test_foreign_photos_replace_as_many_as_asked(source: Path, tmp_path: Path, foreign_scene: bool) -> None:
    other = None
    if foreign_scene:
        other = tmp_path / "other"
        (other / "images").mkdir(parents=True)
        cv2.imwrite(str(other / "images/x.png"), np.full((60, 80, 3), (10, 200, 90), np.uint8))
    folder = made(source, tmp_path, "foreign", 2, other=other)
    before, after = photos_of(source), photos_of(folder)
    changed = [n for n in before if np.abs(before[n] - after[n]).mean() > 10]
    assert len(changed) == 2
    assert sum((before[n] == after[n]).all() for n in before) == PHOTOS - 2
    if foreign_scene:
        assert all(np.allclose(after[n], (10, 200, 90)) for n in changed)


def test_pose_noise_moves_the_building_by_that_many_pixels(source: Path, tmp_path: Path) -> None:
    folder = made(source, tmp_path, "pose", 2.0)
    before, after = model_of(source), model_of(folder)
    moved = []
    for image in after.images.values():
        for spot in image.get_observation_points2D():
            xyz = before.point3D(spot.point3D_id).xyz
            assert np.allclose(after.point3D(spot.point3D_id).xyz, xyz)
            old = before.image(image.image_id).project_point(xyz)
            moved.append(np.linalg.norm(image.project_point(xyz) - old))
    expected = 2.0 * WIDTH / 480
    assert 0.6 * expected < np.sqrt(np.mean(np.square(moved))) < 1.8 * expected


def test_the_focal_length_is_wrong_by_that_share(source: Path, tmp_path: Path) -> None:
    folder = made(source, tmp_path, "focal", 3)
    (old,), (new,) = ([*m.cameras.values()] for m in (model_of(source), model_of(folder)))
    assert abs(new.focal_length_x / old.focal_length_x - 1.03) < 1e-9
    assert new.principal_point_x == old.principal_point_x


def test_points_go_missing(source: Path, tmp_path: Path) -> None:
    folder = made(source, tmp_path, "points_missing", 0.5)
    assert abs(model_of(folder).num_points3D() / model_of(source).num_points3D() - 0.5) < 0.01


def test_points_are_scattered_within_the_scene(source: Path, tmp_path: Path) -> None:
    folder = made(source, tmp_path, "points_outliers", 0.5)
    old, new = model_of(source), model_of(folder)
    points = np.array([p.xyz for p in old.points3D.values()])
    apart = {i: np.linalg.norm(new.point3D(i).xyz - old.point3D(i).xyz) for i in old.point3D_ids()}
    assert abs(np.mean([a > 0.05 for a in apart.values()]) - 0.5) < 0.05
    found = np.array([p.xyz for p in new.points3D.values()])
    assert (found >= points.min(0) - 1e-6).all()
    assert (found <= points.max(0) + 1e-6).all()


@pytest.mark.parametrize(("name", "sign"), [("masks_eroded", -1), ("masks_dilated", 1)])
def test_masks_shrink_and_grow_by_that_many_pixels(source: Path, tmp_path: Path, name: str, sign: int) -> None:
    folder = made(source, tmp_path, name, 8)
    for file, true in masks_of(source).items():
        given = masks_of(folder)[file]
        inner, outer = (given, true) if sign < 0 else (true, given)
        assert not (inner & ~outer).any()
        depth = cv2.distanceTransform(outer.astype(np.uint8), cv2.DIST_L2, 5)
        assert abs(depth[outer & ~inner].max() - 4) < 1.6  # 8 px of 480 are 4 of 240


def test_holes_take_their_share(source: Path, tmp_path: Path) -> None:
    folder = made(source, tmp_path, "masks_holes", 0.3)
    for file, true in masks_of(source).items():
        given = masks_of(folder)[file]
        assert not (given & ~true).any()
        assert abs(given.sum() / true.sum() - 0.7) < 0.06


def test_wrong_masks_show_something_else_on_that_share_of_photos(source: Path, tmp_path: Path) -> None:
    folder = made(source, tmp_path, "masks_wrong", 0.5)
    wrong = [f for f, true in masks_of(source).items() if not (masks_of(folder)[f] & true).any()]
    same = [f for f, true in masks_of(source).items() if (masks_of(folder)[f] == true).all()]
    assert len(wrong) == len(same) == PHOTOS // 2
    assert all(masks_of(folder)[f].any() for f in wrong)


@pytest.mark.parametrize(("name", "level"), [("scale", 1e3), ("offset", 1e6)])
def test_another_frame_shows_the_same_pictures(source: Path, tmp_path: Path, name: str, level: float) -> None:
    folder = made(source, tmp_path, name, level)
    record = json.loads((folder / RECORD).read_text())
    old, new = model_of(source), model_of(folder)
    back = (centres(new) - record["offset"]) / record["scale"]
    assert np.abs(back - centres(old)).max() < 1e-8 * max(1.0, level)
    image = next(iter(new.images.values()))
    for spot in list(image.get_observation_points2D())[:20]:
        there = new.point3D(spot.point3D_id).xyz
        before = old.image(image.image_id).project_point(old.point3D(spot.point3D_id).xyz)
        assert np.linalg.norm(image.project_point(there) - before) < 1e-2


def test_unknown_perturbations_and_scenes_are_refused(source: Path, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no perturbation"):
        made(source, tmp_path, "weather", 1)
    with pytest.raises(BadInput, match="no synthetic scene"):
        perturb(tmp_path, tmp_path / "copy", "noise", 1)
