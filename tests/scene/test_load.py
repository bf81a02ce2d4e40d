# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene stage as users meet it: odd photos, odd folders, damaged inputs, and what stays on disk."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest
from PIL import Image

from benchmarks.synthetic.colmap_scene import (
    SIZE,
    Messages,
    load,
    photo_of,
    reconstruction,
    reprojection,
    write_model,
    write_photo,
    write_scene,
)
from mgf_engine.errors import BadInput, Cancelled, explain
from mgf_engine.files.images import read_rgb
from mgf_engine.jobs.job import Job
from mgf_engine.jobs.results import load_scene_of
from mgf_engine.model.scene import Scene
from mgf_engine.scene.load import load_scene
from mgf_engine.scene.store import FILE, read_saved_scene


@pytest.fixture
def source(tmp_path: Path) -> Path:
    return write_scene(reconstruction(), tmp_path / "scene")


def assert_same(a: Scene, b: Scene) -> None:
    for name in ("points", "colors", "errors", "track_start", "track_view", "track_uv"):
        left, right = getattr(a, name), getattr(b, name)
        assert left.dtype == right.dtype and np.array_equal(left, right)
    assert (a.roots, a.held_out, a.folder) == (b.roots, b.held_out, b.folder)
    assert a.to_normalised.scale == b.to_normalised.scale
    assert np.array_equal(a.to_normalised.translation, b.to_normalised.translation)
    for x, y in zip(a.views, b.views, strict=True):
        assert {k: v for k, v in x.__dict__.items() if k not in ("rotation", "translation")} == {
            k: v for k, v in y.__dict__.items() if k not in ("rotation", "translation")
        }
        assert np.array_equal(x.rotation, y.rotation) and np.array_equal(x.translation, y.translation)


@pytest.mark.parametrize("kind", [".bin", ".txt"])
def test_whole_stage(kind: str, tmp_path: Path) -> None:
    model = reconstruction("OPENCV", rigs=2, sensors=2, frames=3)
    messages = Messages()
    scene = load(write_scene(model, tmp_path / "scene", kind), tmp_path / "job", messages, resolution=100)
    assert len(scene.views) == 12 and [v.name for v in scene.views] == sorted(v.name for v in scene.views)
    assert scene.points.shape == (60, 3) and scene.points.dtype == np.float64
    assert scene.colors.shape == (60, 3) and scene.errors.shape == (60,)
    assert scene.track_start[-1] == len(scene.track_view) == len(scene.track_uv)
    assert reprojection(scene).max() < 0.01
    assert len(scene.roots) == 3 and len(scene.held_out) == 3 and not set(scene.roots) & set(scene.held_out)
    for index, view in enumerate(scene.views):
        assert scene.photo(index).shape == (view.height, view.width, 3)
        assert (view.original_width, view.original_height) == SIZE
    assert_same(scene, read_saved_scene(tmp_path / "job" / "scene"))
    fractions = [m["fraction"] for m in messages.sent if m["type"] == "progress"]
    assert fractions == sorted(fractions) and fractions[-1] == 1.0
    # These photos have no edges, their colours belong to rays and not to points, and they are few; no more is said.
    assert all(any(w in text for w in ("brightness", "degrees", "blurred")) for text in messages.warnings)
    assert sorted(p.name for p in scene.folder.iterdir()) == ["images", FILE]


def test_points_return_to_the_users_frame(source: Path, tmp_path: Path) -> None:
    scene = load(source, tmp_path / "job")
    model = pycolmap.Reconstruction(source / "sparse" / "0")
    xyz = np.array([p.xyz for _, p in sorted(model.points3D.items())])
    ours = scene.to_normalised.invert(scene.points)
    assert np.abs(np.sort(ours, axis=0) - np.sort(xyz, axis=0)).max() < 1e-12
    centres = {image.name: image.projection_center() for image in model.images.values()}
    for view in scene.views:
        assert np.allclose(scene.to_normalised.invert(view.centre), centres[view.name], atol=1e-12)


def test_map_coordinates(tmp_path: Path) -> None:
    """A scene in UTM coordinates loads to the same normalised scene as at the origin, up to their last digits."""
    near = reconstruction()
    far = reconstruction()
    offset = np.array([456789.0, 5432100.0, 120.0])
    far.transform(pycolmap.Sim3d(1.0, pycolmap.Rotation3d(), offset))
    a = load(write_scene(near, tmp_path / "a"), tmp_path / "job a")
    b = load(write_scene(far, tmp_path / "b"), tmp_path / "job b")
    assert np.abs(a.points - b.points).max() < 1e-7
    assert reprojection(b).max() < 0.01
    assert np.allclose(b.to_normalised.invert(b.points), a.to_normalised.invert(a.points) + offset, rtol=0, atol=1e-7)


@pytest.mark.parametrize("name", ["with space.png", "H\u00e4user/\u6559\u4f1a 1.png", "a/b/c.d.e.png"])
def test_names(name: str, tmp_path: Path) -> None:
    model = reconstruction(frames=3)
    model.images[1].name = name
    scene = load(write_scene(model, tmp_path / "Ordner \u00fc \u5c4b"), tmp_path / "Aus gabe \u00f1")
    assert name in [view.name for view in scene.views]
    assert read_saved_scene(scene.folder).photo(0).ndim == 3


@pytest.mark.parametrize("factor", [0.5, 3.0])
def test_photos_at_another_scale(factor: float, tmp_path: Path) -> None:
    model = reconstruction("OPENCV")
    source = write_scene(model, tmp_path / "scene")
    size = (round(factor * SIZE[0]), round(factor * SIZE[1]))
    for image in model.images.values():
        write_photo(source / "images" / image.name, photo_of(image.camera, size))
    messages = Messages()
    scene = load(source, tmp_path / "job", messages)
    assert sum("5 of 5 photos have another size" in text for text in messages.warnings) == 1
    assert (scene.views[0].original_width, scene.views[0].original_height) == size
    assert scene.views[0].width > 0.7 * size[0]  # undistorting crops a little
    assert reprojection(scene).max() < 0.03


def turned_photo(path: Path, seen: np.ndarray, orientation: int) -> None:
    """Store ``seen`` so that a viewer that follows EXIF shows it: the pixels are turned back, the tag is set."""
    back = {1: 1, 3: 3, 6: 8, 8: 6}[orientation]
    pixels = {1: seen, 3: np.rot90(seen, 2), 6: np.rot90(seen, -1), 8: np.rot90(seen)}[back]
    exif = Image.Exif()
    exif[274] = orientation
    Image.fromarray(np.ascontiguousarray(pixels)).save(path, exif=exif, quality=98)


def photo_of_points(image: Any, model: Any) -> np.ndarray:
    """A grey photo with a coloured patch wherever the image observed a point."""
    photo = np.full((SIZE[1], SIZE[0], 3), 128, np.uint8)
    for observed in image.points2D:
        if observed.has_point3D():
            x, y = int(observed.x()), int(observed.y())
            photo[max(0, y - 2) : y + 3, max(0, x - 2) : x + 3] = model.points3D[observed.point3D_id].color
    return photo


@pytest.mark.parametrize("orientation", [3, 6, 8])
@pytest.mark.parametrize("calibrated_on", ["stored pixels", "turned photo"])
def test_exif_rotation_follows_the_camera(orientation: int, calibrated_on: str, tmp_path: Path) -> None:
    """Some programs calibrate the stored pixels, some the turned photo; the camera's size, or the colours, tell."""
    model = reconstruction()
    random = np.random.default_rng(5)
    for point in model.points3D.values():
        point.color = random.integers(0, 256, 3).astype(np.uint8)
    source = write_scene(model, tmp_path / "scene")
    seen = {}
    for image in model.images.values():
        image.name = image.name.replace(".png", ".jpg")
        seen[image.name] = photo = photo_of_points(image, model)
        if calibrated_on == "turned photo":
            turned_photo(source / "images" / image.name, photo, orientation)
        else:
            exif = Image.Exif()
            exif[274] = orientation
            Image.fromarray(photo).save(source / "images" / image.name, exif=exif, quality=98)
    write_model(model, source / "sparse" / "0")
    scene = load(source, tmp_path / "job")
    for index, view in enumerate(scene.views):
        assert np.abs(scene.photo(index).astype(int) - seen[view.name]).mean() < 5
        assert (view.original_width, view.original_height) == SIZE
        lacks = 1 if calibrated_on == "turned photo" else orientation
        assert view.held == lacks  # for what is up


def test_several_cameras_and_sizes(tmp_path: Path) -> None:
    model = reconstruction("SIMPLE_RADIAL", rigs=3, frames=2)
    scene = load(write_scene(model, tmp_path / "scene"), tmp_path / "job", resolution=90)
    assert len(scene.views) == 6
    assert reprojection(scene).max() < 0.01


def test_the_job_may_lie_inside_the_scene(source: Path) -> None:
    scene = load(source, source / "job")
    assert len(load(source, source / "job").views) == len(scene.views)
    shutil.rmtree(source / "sparse")
    with pytest.raises(BadInput, match="No cameras could be found"):
        load(source, source / "job2")


def test_what_is_kept_out_of_training_is_asked_for_by_the_job_that_trains(source: Path, tmp_path: Path) -> None:
    with Job.start(tmp_path / "job", source, user_options={"holdout_every": 0}) as job:
        load_scene(job.source, job.path("scene"), job.config, Messages().reporter)
        assert load_scene_of(job).held_out == ()
    with Job.start(tmp_path / "job", source, user_options={"holdout_every": 4}, resume=True) as job:
        assert load_scene_of(job).held_out == load(source, tmp_path / "other", holdout_every=4).held_out != ()


def test_loading_twice_gives_the_same(source: Path, tmp_path: Path) -> None:
    a = load(source, tmp_path / "job", threads=1)
    first = [read_rgb(a.folder / view.file) for view in a.views]
    b = load(source, tmp_path / "job", threads=4)
    assert_same(a, b)
    assert all(np.array_equal(x, b.photo(i)) for i, x in enumerate(first))


# ---- refused ---------------------------------------------------------------------------------------------------


def _wrong_size(source: Path) -> None:
    write_photo(sorted((source / "images").iterdir())[2], np.zeros((100, 100, 3), np.uint8))


def _three_gone(source: Path) -> None:
    for path in sorted((source / "images").iterdir())[2:]:
        path.unlink()


def _half_model(source: Path) -> None:
    path = source / "sparse" / "0" / "points3D.bin"
    path.write_bytes(path.read_bytes()[:300])


def _all_gone(source: Path) -> None:
    shutil.rmtree(source / "sparse")
    shutil.rmtree(source / "images")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (_wrong_size, "100 x 100 pixels but its camera 160 x"),
        (_three_gone, "3 of 5 photos of the COLMAP model are not there"),
        (_half_model, "cut off or damaged"),
        (_all_gone, "no COLMAP model and too few photos"),
    ],
)
def test_bad_input_leaves_nothing(spoil: Callable[[Path], None], message: str, source: Path, tmp_path: Path) -> None:
    spoil(source)
    with pytest.raises(BadInput, match=message) as caught:
        load(source, tmp_path / "job")
    assert str(caught.value).endswith(".") and "\n" not in str(caught.value)
    assert not (tmp_path / "job" / "scene").exists()


def damage(path: Path, keep: float = 0.0) -> None:
    """Cut a file off, or write something else into it."""
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * keep)] or b"no picture")


def _cut_off(path: Path) -> None:
    damage(path, 0.75)


def _make_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


@pytest.mark.parametrize("damaged", [(2,), (0, 2)], ids=["one photo", "two photos"])
@pytest.mark.parametrize("spoil", [damage, _cut_off, Path.unlink, _make_folder])
def test_a_job_goes_on_without_missing_and_damaged_photos(
    source: Path, tmp_path: Path, spoil: Callable[[Path], None], damaged: tuple[int, ...]
) -> None:
    paths = sorted((source / "images").iterdir())
    whole = load(source, tmp_path / "whole")
    names = [paths[i].name for i in damaged]
    for i in damaged:
        spoil(paths[i])
    messages = Messages()
    scene = load(source, tmp_path / "job", messages)
    assert [view.name for view in scene.views] == [path.name for path in paths if path.name not in names]
    assert scene.left_out == tuple(names) and reprojection(scene).max() < 0.01
    assert len(list((scene.folder / "images").iterdir())) == len(scene.views)
    assert np.array_equal(scene.views[0].centre, next(v for v in whole.views if v.name == scene.views[0].name).centre)
    (warning,) = [text for text in messages.warnings if "cannot be read" in text]
    named = ", ".join(f"'{name}'" for name in names)
    assert warning.startswith(f"{len(names)} of 5 photos are missing or cannot be read and are left out ({named}); put")
    assert_same(scene, read_saved_scene(scene.folder))


def test_a_damaged_photo_is_not_asked_how_it_is_turned(tmp_path: Path) -> None:
    """Where only the colours tell an orientation, the photo is decoded before all others."""
    source = write_scene(reconstruction(), tmp_path / "scene")
    paths = sorted((source / "images").iterdir())
    seen = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    turned_photo(paths[1], seen, 3)
    damage(paths[1], 0.75)
    assert paths[1].name in load(source, tmp_path / "job").left_out


@pytest.mark.parametrize("photos_alone", [False, True])
@pytest.mark.parametrize("keep", [0, 3], ids=["no picture", "cut off"])
def test_photos_that_cannot_be_read_are_counted_and_the_first_is_named(
    source: Path, tmp_path: Path, keep: int, photos_alone: bool
) -> None:
    if photos_alone and keep:
        pytest.skip("COLMAP itself decodes them")
    for path in sorted((source / "images").iterdir())[1:4]:
        damage(path, keep / 4)
    if photos_alone:
        shutil.rmtree(source / "sparse")
    first = sorted((source / "images").iterdir())[1].name
    with pytest.raises(BadInput, match=rf"^3 of 5 photos cannot be used, the first of them: The photo '.*{first}'"):
        load(source, tmp_path / "job")


def test_a_failure_takes_an_earlier_scene_away(source: Path, tmp_path: Path) -> None:
    load(source, tmp_path / "job")
    _three_gone(source)
    with pytest.raises(BadInput):
        load(source, tmp_path / "job")
    with pytest.raises(BadInput, match="cannot be used"):
        read_saved_scene(tmp_path / "job" / "scene")


def test_not_a_folder(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="not a folder"):
        load(tmp_path / "none", tmp_path / "job")


def test_output_that_cannot_be_written(source: Path, tmp_path: Path) -> None:
    (tmp_path / "job").write_text("a file")
    with pytest.raises(BadInput, match="write to"):
        load(source, tmp_path / "job")


def test_a_full_disk_is_called_that(source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("mgf_engine.scene.load.save_scene", full)
    with pytest.raises(OSError) as caught:
        load(source, tmp_path / "job")
    said = explain(caught.value, place=tmp_path / "job")[1]
    assert said == f"The disk of '{tmp_path / 'job'}' is full; free some space and run again with --resume."


def test_cancelling(source: Path, tmp_path: Path) -> None:
    messages = Messages()
    messages.reporter.cancel()
    with pytest.raises(Cancelled):
        load(source, tmp_path / "job", messages)
    assert not (tmp_path / "job" / "scene").exists()


# ---- the stored scene ------------------------------------------------------------------------------------------


def test_damaged_stores_are_refused(source: Path, tmp_path: Path) -> None:
    folder = load(source, tmp_path / "job").folder
    path = folder / FILE
    data = path.read_bytes()
    for length in [*range(0, len(data), 97), len(data) - 1]:
        path.write_bytes(data[:length])
        with pytest.raises(BadInput, match="cannot be used"):
            read_saved_scene(folder)
    for at in range(0, len(data), 61):
        path.write_bytes(data[:at] + bytes([data[at] ^ 0x10]) + data[at + 1 :])
        try:
            read_saved_scene(folder)  # a few bytes of the archive's bookkeeping carry no meaning
        except BadInput as error:
            assert "cannot be used" in str(error)
    path.write_bytes(data)
    photo = folder / read_saved_scene(folder).views[1].file
    photo.unlink()
    with pytest.raises(BadInput, match="missing or of another size"):
        read_saved_scene(folder)


def test_stored_objects_are_not_executed(source: Path, tmp_path: Path) -> None:
    folder = load(source, tmp_path / "job").folder
    arrays: dict[str, Any] = dict(np.load(folder / FILE))
    arrays["points"] = np.array([{"a": 1}], object)
    np.savez(folder / FILE, **arrays)
    with pytest.raises(BadInput, match="cannot be used"):
        read_saved_scene(folder)
