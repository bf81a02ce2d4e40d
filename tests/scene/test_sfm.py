# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos alone: cameras are found, the work is taken up again, and photos that cannot work are refused."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap
import pytest

from benchmarks.synthetic.colmap_scene import Messages, load, reprojection, write_photo
from mgf_engine.errors import BadInput, Cancelled
from mgf_engine.scene import sfm
from mgf_engine.scene.pairs import choose_pairs, similarities, vlad

SIZE, FOCAL = (400, 300), 380.0
VIEWS = 7


def corner_view(angle: float) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and centre of a camera that looks at the corner of a room from ``angle`` (radians)."""
    centre = np.array([5 * np.cos(angle), 5 * np.sin(angle), 2.0])
    forward = np.array([0.5, 0.5, 0.8]) - centre
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward]), centre


def corner_photo(angle: float) -> np.ndarray:
    """Three textured planes x = 0, y = 0, z = 0 seen by the camera, [height, width, 3]."""
    rotation, centre = corner_view(angle)
    x, y = np.meshgrid(np.arange(SIZE[0]) + 0.5 - SIZE[0] / 2, np.arange(SIZE[1]) + 0.5 - SIZE[1] / 2)
    rays = np.stack([x / FOCAL, y / FOCAL, np.ones_like(x)], -1) @ rotation
    with np.errstate(divide="ignore"):
        distance = np.where(rays < 0, -centre / rays, np.inf)
    plane = distance.argmin(-1)
    hit = centre + rays * np.take_along_axis(distance, plane[..., None], -1)
    photo = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    for axis in range(3):
        u, v = (hit[..., k] for k in range(3) if k != axis)
        random = np.random.default_rng(axis)
        texture = cv2.resize(random.integers(0, 256, (90, 90, 3)).astype(np.uint8), (720, 720))
        colors = cv2.remap(texture, (u * 90 + 5).astype(np.float32), (v * 90 + 5).astype(np.float32), cv2.INTER_LINEAR)
        photo[plane == axis] = colors[plane == axis]
    return photo


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("f\u00f6tos of a corner")
    for i in range(VIEWS):
        write_photo(folder / f"view {i}.png", corner_photo(0.3 + 0.16 * i))
    return folder


@pytest.fixture(scope="module")
def solved(photos: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    job = tmp_path_factory.mktemp("solved")
    load(photos, job)
    return job


def street_photo(along: float) -> np.ndarray:
    """A street between two walls x = -2 and x = 3, seen along +y from 1.6 m above its pavement, [height, width, 3]."""
    x, y = np.meshgrid(np.arange(SIZE[0]) + 0.5 - SIZE[0] / 2, np.arange(SIZE[1]) + 0.5 - SIZE[1] / 2)
    photo = np.full((SIZE[1], SIZE[0], 3), 200, np.uint8)
    with np.errstate(divide="ignore"):
        walls = ((x < 0, -2.0 * FOCAL / x), (x > 0, 3.0 * FOCAL / x), (y > 0, 1.6 * FOCAL / y))
    depths = np.stack([np.where(seen, depth, np.inf) for seen, depth in walls])
    nearest, depth = depths.argmin(0), depths.min(0)
    high = y * depth / FOCAL < -4  # sky
    for number in range(3):
        across = (y if number < 2 else x) * depth / FOCAL
        texture = np.random.default_rng(number).integers(0, 256, (60, 400, 3)).astype(np.uint8)
        texture = cv2.resize(texture, (3200, 480), interpolation=cv2.INTER_LINEAR)
        u, v = np.minimum((depth + along) * 60, 3199), (across + 4) * 60
        colors = cv2.remap(texture, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR)
        here = (nearest == number) & ~high & (depth < 40)
        photo[here] = colors[here]
    return photo


def test_photos_along_a_street_are_found(tmp_path: Path) -> None:
    """COLMAP begins no model with a pair in forward motion; here there is no other."""
    places = [0.0, 1.0, 2.1, 3.0, 4.2, 5.0, 6.1]
    for number, along in enumerate(places):
        write_photo(tmp_path / "street" / f"{number}.png", street_photo(along))
    scene = load(tmp_path / "street", tmp_path / "job")
    assert len(scene.views) == len(places)
    found = np.array([view.centre for view in scene.views])
    steps = np.linalg.norm(np.diff(found, axis=0), axis=1)
    assert np.allclose(steps / steps.mean(), np.diff(places) / np.diff(places).mean(), atol=0.1)


def test_cameras_are_found(photos: Path, tmp_path: Path) -> None:
    messages = Messages()
    scene = load(photos, tmp_path / "job", messages)
    assert [view.name for view in scene.views] == [f"view {i}.png" for i in range(VIEWS)]
    assert np.median(reprojection(scene)) < 0.5
    truth = np.array([corner_view(0.3 + 0.16 * i)[1] for i in range(VIEWS)])
    found = np.array([view.centre for view in scene.views])
    steps = [np.linalg.norm(np.diff(c, axis=0), axis=1) for c in (truth, found)]
    assert np.allclose(steps[1] / steps[1].mean(), steps[0] / steps[0].mean(), atol=0.05)
    assert scene.colors.std() > 20  # the points carry the photos' colours
    fractions = [m["fraction"] for m in messages.sent if m["type"] == "progress"]
    assert fractions == sorted(fractions) and fractions[-1] == 1.0


@pytest.fixture(scope="module")
def far_apart(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three photos 34 degrees apart, between which too few plain SIFT features match."""
    folder = tmp_path_factory.mktemp("far apart")
    for i, angle in enumerate((0.2, 0.785, 1.37)):
        write_photo(folder / f"{i}.png", corner_photo(angle))
    return folder


def test_a_second_attempt_matches_photos_taken_far_apart(far_apart: Path, tmp_path: Path) -> None:
    messages = Messages()
    messages.reporter._min_interval = 0.0
    scene = load(far_apart, tmp_path / "job", messages)
    assert len(scene.views) == 3 and np.median(reprojection(scene)) < 0.5
    said = "0 of 3 photos could be registered at first; structure from motion runs again with affine-covariant features"
    assert len([text for text in messages.warnings if text.startswith(said)]) == 1
    assert "features, second attempt" in {_step(m) for m in messages.sent}
    fractions = [m["fraction"] for m in messages.sent if m["type"] == "progress"]
    assert fractions == sorted(fractions) and fractions[-1] == 1.0


def test_the_second_attempt_can_be_turned_off(far_apart: Path, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="No cameras could be found from the 3 photos"):
        load(far_apart, tmp_path / "job", **{"structure_from_motion.retry_below": 0.0})


def test_an_interrupted_second_attempt_is_taken_up(far_apart: Path, tmp_path: Path) -> None:
    messages = Messages()
    messages.reporter._min_interval = 0.0
    messages.reporter.sinks.append(lambda m: messages.reporter.cancel() if "second" in _step(m) else None)
    with pytest.raises(Cancelled):
        load(far_apart, tmp_path / "job", messages)
    again = Messages()
    again.reporter._min_interval = 0.0
    assert len(load(far_apart, tmp_path / "job", again).views) == 3
    assert "features" not in {_step(m) for m in again.sent}  # those of the first attempt


def test_photos_of_something_else_are_not_searched_twice(photos: Path, tmp_path: Path) -> None:
    shutil.copytree(photos, tmp_path / "photos")
    write_photo(tmp_path / "photos" / "fog.png", np.full((SIZE[1], SIZE[0], 3), 128, np.uint8))
    messages = Messages()
    scene = load(tmp_path / "photos", tmp_path / "job", messages)
    assert len(scene.views) == VIEWS and scene.left_out == ("fog.png",)
    assert not (tmp_path / "job" / "scene" / "sfm" / "affine").exists()
    assert not [text for text in messages.warnings if "at first" in text]


def test_unrelated_photos_are_not_searched_twice(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    for i in range(4):
        small = random.integers(0, 256, (30, 40, 3)).astype(np.uint8)
        write_photo(tmp_path / "photos" / f"{i}.png", cv2.resize(small, SIZE, interpolation=cv2.INTER_CUBIC))
    messages = Messages()
    with pytest.raises(BadInput, match="No cameras could be found from the 4 photos"):
        load(tmp_path / "photos", tmp_path / "job", messages)
    assert not (tmp_path / "job" / "scene" / "sfm" / "affine").exists()


def test_the_first_attempt_is_kept_where_the_second_places_no_more(photos: Path, tmp_path: Path) -> None:
    shutil.copytree(photos, tmp_path / "photos")
    write_photo(tmp_path / "photos" / "fog.png", np.full((SIZE[1], SIZE[0], 3), 128, np.uint8))
    messages = Messages()
    scene = load(tmp_path / "photos", tmp_path / "job", messages, **{"structure_from_motion.retry_matches": 0})
    assert len(scene.views) == VIEWS and scene.left_out == ("fog.png",)
    sfm_folder = tmp_path / "job" / "scene" / "sfm"
    kept, first, second = (
        pycolmap.Reconstruction(sfm_folder / part) for part in ("model", "sift/model", "affine/model")
    )
    assert first.num_reg_images() == second.num_reg_images() == VIEWS
    assert kept.num_points3D() == first.num_points3D() != second.num_points3D()


def test_a_finished_model_is_used_again(
    photos: Path, solved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = tmp_path / "job"
    shutil.copytree(solved, job)
    monkeypatch.setattr(sfm, "_Worker", None)
    assert len(load(photos, job, resolution=200).views) == VIEWS


@pytest.mark.parametrize("step", ["features", "cameras"])
def test_an_interrupted_run_is_taken_up(step: str, photos: Path, tmp_path: Path) -> None:
    """Stopped at any step (photos may have numbers for names by then), the run goes on and ends well."""
    job = tmp_path / "job"
    messages = Messages()
    messages.reporter._min_interval = 0.0
    messages.reporter.sinks.append(lambda m: messages.reporter.cancel() if _step(m) == step else None)
    with pytest.raises(Cancelled):
        load(photos, job, messages)
    assert not (job / "scene" / "scene.npz").exists()
    again = Messages()
    again.reporter._min_interval = 0.0
    scene = load(photos, job, again)
    assert [view.name for view in scene.views] == [f"view {i}.png" for i in range(VIEWS)]
    if step == "cameras":
        assert "features" not in {_step(m) for m in again.sent}


def _step(message: dict[str, Any]) -> str:
    return str(message.get("figures", {}).get("doing", ""))


def test_a_crash_of_the_worker_is_one_sentence(photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sfm.sys, "executable", "/bin/false")
    with pytest.raises(BadInput, match="COLMAP ended with code 1"):
        load(photos, tmp_path / "job")


def test_the_worker_ends_with_the_job(photos: Path, solved: Path, tmp_path: Path) -> None:
    """When the job is killed, the pipe to the worker closes and the worker ends too."""
    shutil.copytree(solved / "scene" / "sfm", tmp_path / "sfm")
    shutil.rmtree(tmp_path / "sfm" / "model")
    shutil.rmtree(tmp_path / "sfm" / "sift")
    command = [sys.executable, "-m", "mgf_engine.scene.sfm_worker", str(tmp_path / "sfm")]
    worker = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert worker.stdout is not None and worker.stdout.readline() == b"features\n"
    worker.communicate(timeout=20)
    assert worker.returncode == 1


def test_other_photos_start_anew(photos: Path, solved: Path, tmp_path: Path) -> None:
    shutil.copytree(solved, tmp_path / "job")
    fewer = tmp_path / "fewer"
    shutil.copytree(photos, fewer)
    (fewer / "view 6.png").unlink()
    scene = load(fewer, tmp_path / "job")
    names = [view.name for view in scene.views]
    assert len(names) >= VIEWS - 2 and "view 6.png" not in names  # a photo at the end may fail to be placed


@pytest.mark.parametrize("count", [1, 2])
def test_too_few_photos(count: int, photos: Path, tmp_path: Path) -> None:
    for i in range(count):
        (tmp_path / "few").mkdir(exist_ok=True)
        shutil.copy(photos / f"view {i}.png", tmp_path / "few")
    with pytest.raises(BadInput, match=rf"no COLMAP model and too few photos \({count}\)"):
        load(tmp_path / "few", tmp_path / "job")


def test_photos_that_do_not_belong_together(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    for i in range(3):
        small = random.integers(0, 256, (40, 40, 3)).astype(np.uint8)
        write_photo(tmp_path / "noise" / f"{i}.png", cv2.resize(small, (200, 200)))
    with pytest.raises(BadInput, match="No cameras could be found from the 3 photos"):
        load(tmp_path / "noise", tmp_path / "job")


def test_damaged_photos_are_left_out(photos: Path, tmp_path: Path) -> None:
    """One whose header cannot be read, and one that COLMAP fails to decode."""
    shutil.copytree(photos, tmp_path / "photos")
    (tmp_path / "photos" / "view 3.png").write_text("no")
    cut = tmp_path / "photos" / "view 5.png"
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size // 2])
    messages = Messages()
    scene = load(tmp_path / "photos", tmp_path / "job", messages)
    assert {"view 3.png", "view 5.png"} <= set(scene.left_out)
    (warning,) = [text for text in messages.warnings if "cannot be read" in text]
    said = f"2 of {VIEWS} photos are missing or cannot be read and are left out ('view 3.png', 'view 5.png')"
    assert warning.startswith(said)


def test_pairs_of_a_sequence(tmp_path: Path) -> None:
    """80 photos of a loop whose descriptors drift slowly: neighbours, far steps, and the closed loop are matched."""
    random = np.random.default_rng(3)
    kinds = random.integers(0, 160, (80, 25, 128))  # what each place of the loop looks like
    with pycolmap.Database.open(tmp_path / "db") as database:
        camera = pycolmap.Camera.create_from_model_name(1, "PINHOLE", 100.0, 100, 100)
        camera_id = database.write_camera(camera)
        ids = []
        for i in range(80):
            seen = np.concatenate([kinds[(i + k) % 80] for k in range(6)]) + random.integers(0, 8, (150, 128))
            image_id = database.write_image(pycolmap.Image(name=f"{i:03d}.jpg", camera_id=camera_id))
            keypoints = np.zeros((150, 4), np.float32)
            keypoints[:, 2] = 1.0
            database.write_keypoints(image_id, keypoints)
            descriptors = pycolmap.FeatureDescriptors(pycolmap.FeatureExtractorType.SIFT, seen.astype(np.uint8))
            database.write_descriptors(image_id, descriptors)
            ids.append(image_id)
        everything = choose_pairs(database, ids, True, 0)
        pairs = choose_pairs(database, ids, False, 0)
        alike = similarities(vlad(database, ids, 0))
    assert len(everything) == 80 * 79 // 2
    assert len(pairs) == len(set(pairs)) < 0.6 * len(everything)
    assert all(0 <= i < j < 80 for i, j in pairs)
    assert {(i, i + 1) for i in range(79)} <= set(pairs)
    assert {(0, 79), (1, 79), (0, 78)} <= set(pairs)  # the loop closes
    assert np.allclose(np.diag(alike), 1.0, atol=1e-3)
    assert alike[0, 1] > alike[0, 40]
