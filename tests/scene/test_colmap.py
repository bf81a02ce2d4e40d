# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP models of every layout are read like pycolmap reads them; damaged ones are refused in one sentence."""

from __future__ import annotations

import errno
import os
import re
import shutil
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.foreign_names import PLAIN
from support.model_places import SEVERAL, write_project

from benchmarks.synthetic.colmap_scene import photo_of, reconstruction, write_model, write_photo, write_scene
from mgf_engine.errors import BadInput
from mgf_engine.jobs.estimate import inspect_photos
from mgf_engine.scene.colmap import find_model, find_photos, list_photos, photo_names, plain_name, read_model

PARTS = ("cameras", "images", "points3D", "rigs", "frames")


def compare_with_pycolmap(folder: Path) -> None:
    ours, theirs = read_model(folder), pycolmap.Reconstruction(folder)
    assert set(ours.cameras) == set(theirs.cameras)
    for key, camera in theirs.cameras.items():
        mine = ours.cameras[key]
        assert (mine.model, mine.width, mine.height) == (camera.model_name, camera.width, camera.height)
        assert np.array_equal(mine.params, camera.params)
    assert len(ours.images) == theirs.num_reg_images()
    for mine in ours.images:
        image = theirs.images[mine.id]
        pose = image.cam_from_world()
        assert mine.name == image.name and mine.camera_id == image.camera_id
        assert np.allclose(np.roll(pose.rotation.quat, 1), mine.quaternion, atol=1e-12)
        assert np.allclose(pose.translation, mine.translation, atol=1e-12)
        assert np.allclose([p.xy for p in image.points2D], mine.keypoints, atol=1e-9)
        theirs_ids = [p.point3D_id if p.has_point3D() else -1 for p in image.points2D]
        assert theirs_ids == mine.point_ids.tolist()
    points = ours.points
    assert set(points.ids.tolist()) == set(theirs.points3D)
    for i, key in enumerate(points.ids.tolist()):
        point = theirs.points3D[key]
        assert np.allclose(point.xyz, points.xyz[i], atol=1e-12) and np.array_equal(point.color, points.rgb[i])
        elements = slice(points.start[i], points.start[i + 1])
        track = [(e.image_id, e.point2D_idx) for e in point.track.elements]
        assert track == list(zip(points.image_ids[elements].tolist(), points.keypoint[elements].tolist(), strict=True))


@pytest.mark.parametrize("kind", [".bin", ".txt"])
@pytest.mark.parametrize("model", ["SIMPLE_RADIAL", "OPENCV"])
def test_reads_what_pycolmap_reads(kind: str, model: str, tmp_path: Path) -> None:
    compare_with_pycolmap(write_model(reconstruction(model, rigs=2, sensors=2, frames=3), tmp_path, kind))


@pytest.mark.parametrize("kind", [".bin", ".txt"])
def test_reads_models_of_older_colmap(kind: str, tmp_path: Path) -> None:
    folder = write_model(reconstruction(), tmp_path, kind)
    for part in ("rigs", "frames"):
        (folder / (part + kind)).unlink()
    compare_with_pycolmap(folder)


def test_reads_text_from_other_programs(tmp_path: Path) -> None:
    """No comments, no last line end, Windows line ends, names with spaces and accents, empty keypoint lines."""
    (tmp_path / "cameras.txt").write_bytes(b"1 PINHOLE 100 80 90 90 50 40")
    images = "1 1 0 0 0 0 0 5 1 my h\u00e4user/a b.jpg\r\n10.5 20.5 7\r\n2 1 0 0 0 1 0 5 1 c.jpg\r\n\r\n"
    (tmp_path / "images.txt").write_bytes(images.encode())
    (tmp_path / "points3D.txt").write_bytes(b"7 0.1 0.2 0.3 255 0 9 -1 1 0\n8 1 2 3 1 2 3 0.5")
    model = read_model(tmp_path)
    assert [image.name for image in model.images] == ["c.jpg", "my h\u00e4user/a b.jpg"]
    assert model.points.start.tolist() == [0, 1, 1]
    assert model.images[1].keypoints.tolist() == [[10.5, 20.5]]


# ---- layouts ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model_at", "photos_at", "given"),
    [
        ("sparse/0", "images", "."),
        ("sparse", "images", "."),
        (".", "images", "."),
        (".", ".", "."),
        ("sparse/0", "images", "sparse/0"),
        ("sparse/0", "images", "sparse"),
        ("colmap/sparse/0", "images", "."),
        ("colmap", "photos", "."),
        ("dense/0/sparse", "dense/0/images", "."),
        ("sparse/0", "sparse/0", "."),
        ("sparse/0", "deep/er/still", "."),
        ("model", "images", "model"),
    ],
)
def test_finds_model_and_photos(model_at: str, photos_at: str, given: str, tmp_path: Path) -> None:
    model = reconstruction(frames=3)
    write_model(model, tmp_path / model_at)
    names = sorted(image.name for image in model.images.values())
    for name in names:
        write_photo(tmp_path / photos_at / name, photo_of(model.cameras[1]))
    source = tmp_path / given
    found = find_model(source)
    assert found is not None and found.resolve() == (tmp_path / model_at).resolve()
    paths = find_photos(names, found, source)
    assert [p.resolve() for p in paths] == [(tmp_path / photos_at / n).resolve() for n in names]


@pytest.mark.parametrize(("models", "taken"), SEVERAL.values(), ids=list(SEVERAL))
def test_one_of_several_models_is_taken(models: dict[str, int], taken: str, tmp_path: Path) -> None:
    write_project(tmp_path, models)
    assert find_model(tmp_path) == tmp_path / taken


def test_a_damaged_model_does_not_win_over_a_sound_one(tmp_path: Path) -> None:
    broken = write_model(reconstruction(frames=6), tmp_path / "sparse" / "0")
    (broken / "images.bin").write_bytes(b"\xff" * 40)
    write_model(reconstruction(frames=3), tmp_path / "sparse" / "1")
    assert find_model(tmp_path) == tmp_path / "sparse" / "1"


def test_models_of_jobs_are_not_looked_at(tmp_path: Path) -> None:
    write_model(reconstruction(frames=6), tmp_path / "job" / "sparse")
    assert find_model(tmp_path, exclude=tmp_path / "job") is None


def test_photos_in_folders_and_with_other_spelling(tmp_path: Path) -> None:
    for name in ("left/a.JPG", "right/a.jpg", "\u00c4 b/x.png"):
        write_photo(tmp_path / "pictures" / "set" / name, np.zeros((8, 8, 3), np.uint8))
    names = ["left\\a.jpg", "right/a.jpg", "A\u0308 b/x.png"]  # Windows, as it is, macOS
    model = tmp_path / "sparse" / "0"
    model.mkdir(parents=True)
    expected = [tmp_path / "pictures" / "set" / n for n in ("left/a.JPG", "right/a.jpg", "\u00c4 b/x.png")]
    assert find_photos(names, model, tmp_path) == expected


@pytest.mark.parametrize(("name", "windows", "plain"), PLAIN)
def test_names_never_lead_to_another_machine(name: str, windows: bool, plain: str) -> None:
    assert plain_name(name, windows) == plain


def test_photos_whose_names_are_whole_paths_are_looked_for_in_the_scene_alone(tmp_path: Path) -> None:
    elsewhere, here = tmp_path / "elsewhere" / "a.png", tmp_path / "scene" / "images" / "a.png"
    for path in (elsewhere, here):
        write_photo(path, np.zeros((8, 8, 3), np.uint8))
    assert find_photos([str(elsewhere)], tmp_path / "scene" / "sparse", tmp_path / "scene") == [here]
    here.unlink()
    with pytest.raises(BadInput, match="1 of 1 photos"):
        find_photos([str(elsewhere)], tmp_path / "scene" / "sparse", tmp_path / "scene")


def test_a_missing_photo_is_expected_beside_the_others(tmp_path: Path) -> None:
    names = [f"{k}.jpg" for k in range(4)]
    for name in names[1:]:
        write_photo(tmp_path / "photos" / name, np.zeros((8, 8, 3), np.uint8))
    assert find_photos(names, tmp_path / "sparse", tmp_path) == [tmp_path / "photos" / name for name in names]
    for folder in ("x/1", "x/2"):
        write_photo(tmp_path / folder / "0.jpg", np.zeros((8, 8, 3), np.uint8))
    with pytest.raises(BadInput, match="1 of 4 photos"):  # either may be the one
        find_photos(names, tmp_path / "sparse", tmp_path)


def test_missing_and_ambiguous_photos_are_refused(tmp_path: Path) -> None:
    model = tmp_path / "sparse"
    model.mkdir()
    with pytest.raises(BadInput, match=r"2 of 2 photos .*first: 'a.jpg'\).* or take them out of the model"):
        find_photos(["a.jpg", "b.jpg"], model, tmp_path)
    for folder in ("x/1", "x/2"):
        write_photo(tmp_path / folder / "a.jpg", np.zeros((8, 8, 3), np.uint8))
    with pytest.raises(BadInput, match="1 of 1 photos"):
        find_photos(["a.jpg"], model, tmp_path)


def test_lists_photos_without_a_model(tmp_path: Path) -> None:
    for name in ("images/b.jpg", "images/sub/a.png", "other/c.jpg"):
        write_photo(tmp_path / name, np.zeros((8, 8, 3), np.uint8))
    assert list_photos(tmp_path) == (tmp_path / "images", ["b.jpg", "sub/a.png"])
    shutil.rmtree(tmp_path / "images")
    assert list_photos(tmp_path) == (tmp_path, ["other/c.jpg"])
    assert list_photos(tmp_path, exclude=tmp_path / "other")[1] == []


# ---- damage ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def tiny() -> object:
    return reconstruction(rigs=1, sensors=2, frames=1, points=3)


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("kind", [".bin", ".txt"])
def test_truncation_at_every_byte_is_refused(part: str, kind: str, tiny: object, tmp_path: Path) -> None:
    path = write_model(tiny, tmp_path, kind) / (part + kind)
    data = path.read_bytes()
    read_model(tmp_path)
    for length in range(len(data)):
        path.write_bytes(data[:length])
        with pytest.raises(BadInput, match=r"[a-z].*[;,] .*\.$"):
            read_model(tmp_path)


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("kind", [".bin", ".txt"])
def test_flipped_bits_never_do_worse_than_bad_input(part: str, kind: str, tiny: object, tmp_path: Path) -> None:
    """A flipped bit in a coordinate is a valid model; whatever is not must be refused, quickly and in one piece."""
    path = write_model(tiny, tmp_path, kind) / (part + kind)
    data = bytearray(path.read_bytes())
    refused = 0
    for at in range(len(data)):
        original = data[at]
        data[at] ^= 1 << (at % 8)
        path.write_bytes(data)
        refused += _refused(tmp_path)
        data[at] = original
    assert refused > 0


@settings(max_examples=60)
@given(
    part=st.sampled_from(PARTS),
    kind=st.sampled_from([".bin", ".txt"]),
    junk=st.binary(max_size=200),
    at=st.floats(0, 1),
)
def test_junk_never_does_worse_than_bad_input(
    part: str, kind: str, junk: bytes, at: float, tiny: object, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("junk")
    path = write_model(tiny, folder, kind) / (part + kind)
    data = path.read_bytes()
    cut = int(at * len(data))
    path.write_bytes(data[:cut] + junk + data[cut + len(junk) :])
    _refused(folder)
    shutil.rmtree(folder)


def _refused(folder: Path) -> bool:
    try:
        read_model(folder)
    except BadInput as error:
        assert str(error).endswith(".") and "\n" not in str(error)
        return True
    return False


@pytest.mark.parametrize("part", PARTS[:3])
@pytest.mark.parametrize("kind", [".bin", ".txt"])
def test_missing_and_empty_files(part: str, kind: str, tmp_path: Path) -> None:
    folder = write_model(reconstruction(), tmp_path / "sparse", kind)
    (folder / (part + kind)).write_bytes(b"")
    with pytest.raises(BadInput):
        read_model(folder)
    (folder / (part + kind)).unlink()
    with pytest.raises(BadInput, match=part):
        find_model(tmp_path)


def test_counts_beyond_memory(tmp_path: Path) -> None:
    folder = write_model(reconstruction(), tmp_path)
    for part in PARTS:
        path = folder / (part + ".bin")
        data = path.read_bytes()
        for count in (1 << 20, 1 << 40, (1 << 64) - 1):
            path.write_bytes(struct.pack("<Q", count) + data[8:])
            with pytest.raises(BadInput, match="cut off or damaged"):
                read_model(folder)
        path.write_bytes(data)


Change = Callable[[str], str]


def edited(folder: Path, part: str, change: Change) -> Path:
    """A text model with one file rewritten."""
    write_model(reconstruction(frames=3, points=10), folder, ".txt")
    path = folder / (part + ".txt")
    path.write_text(change(path.read_text()))
    return folder


def _field(line_start: str, index: int, value: str) -> Change:
    def change(text: str) -> str:
        lines = text.split("\n")
        at = next(i for i, line in enumerate(lines) if line.startswith(line_start))
        fields = lines[at].split(" ")
        fields[index] = value
        lines[at] = " ".join(fields)
        return "\n".join(lines)

    return change


@pytest.mark.parametrize(
    ("part", "change", "message"),
    [
        ("cameras", _field("1 ", 1, "KANNALA"), "unknown camera model 'KANNALA'"),
        ("cameras", _field("1 ", 2, "0"), "has the size 0 x 120"),
        ("cameras", _field("1 ", 2, "99999999"), "has the size"),
        ("cameras", _field("1 ", 4, "nan"), "not finite"),
        ("cameras", _field("1 ", 4, "-150"), "impossible focal length"),
        ("cameras", _field("1 ", 0, "2"), "camera 1, which is missing"),
        ("images", _field("1 ", 1, "nan"), "pose that is not finite"),
        ("images", _field("1 ", 6, "inf"), "pose that is not finite"),
        ("images", _field("1 ", 6, "1e300"), "pose that is not finite or beyond"),
        ("images", _field("2 ", 0, "1"), "listed twice"),
        ("images", _field("2 ", 9, "camera000001_frame000000.png"), "listed twice"),
        ("images", lambda _: "# nothing\n", "no registered photo"),
        ("points3D", _field("1 ", 1, "nan"), "not finite"),
        ("points3D", _field("1 ", 4, "256"), "colour"),
        ("points3D", _field("2 ", 0, "1"), "point"),
        ("points3D", lambda _: "# nothing\n", "no points"),
        ("points3D", _field("1 ", 8, "77"), "disagree"),
        ("points3D", _field("1 ", 9, "99999"), "disagree"),
    ],
)
def test_impossible_contents(part: str, change: Change, message: str, tmp_path: Path) -> None:
    folder = edited(tmp_path, part, change)
    for other in ("rigs.txt", "frames.txt"):
        (folder / other).unlink()
    with pytest.raises(BadInput, match=message):
        read_model(folder)


def test_a_zero_quaternion_is_no_pose(tmp_path: Path) -> None:
    def zero(text: str) -> str:
        for i in (1, 2, 3, 4):
            text = _field("1 ", i, "0")(text)
        return text

    with pytest.raises(BadInput, match="pose"):
        read_model(edited(tmp_path, "images", zero))


def test_spherical_cameras_are_refused(tmp_path: Path) -> None:
    write_model(reconstruction(), tmp_path, ".txt")
    (tmp_path / "cameras.txt").write_text("1 EQUIRECTANGULAR 160 120 160 120\n")
    with pytest.raises(BadInput, match="no image plane"):
        read_model(tmp_path)


def test_files_of_two_models_are_refused(tmp_path: Path) -> None:
    folder = write_model(reconstruction(points=20), tmp_path / "a")
    other = write_model(reconstruction(points=30), tmp_path / "b")
    shutil.copy(other / "points3D.bin", folder / "points3D.bin")
    with pytest.raises(BadInput, match="two models"):
        read_model(folder)


def test_scene_written_by_the_helper_is_sound(tmp_path: Path) -> None:
    compare_with_pycolmap(write_scene(reconstruction(), tmp_path) / "sparse" / "0")


def test_folders_that_one_may_not_look_into_are_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = write_scene(reconstruction(), tmp_path / "drive")
    names = [image.name for image in read_model(find_model(source) or source).images]
    (source / "System Volume Information").mkdir()
    stat = os.stat

    def denied(path: Any, *more: Any, **how: Any) -> os.stat_result:
        if not isinstance(path, int) and "Information/" in os.fspath(path).replace(os.sep, "/"):
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return stat(path, *more, **how)

    monkeypatch.setattr(os, "stat", denied)
    with pytest.raises(PermissionError):
        (source / "System Volume Information" / "x").stat()
    model = find_model(source)
    assert model == source / "sparse" / "0"
    (source / "images").rename(source / "DCIM")
    assert {p.parent.name for p in find_photos(names, model, source)} == {"DCIM"}
    assert len(list_photos(source)[1]) == len(names)


def test_photos_of_kinds_that_are_not_read_are_called_so(tmp_path: Path) -> None:
    """A folder of a phone's HEIC photos was said to hold none."""
    for name in ("IMG_1.HEIC", "IMG_2.heic", "a.jpg"):
        (tmp_path / name).write_bytes(b"x")
    with pytest.raises(BadInput, match=r"2 photos in .* not read \(first: 'IMG_1.HEIC'\); export them as JPEG"):
        inspect_photos(tmp_path)
    (tmp_path / "IMG_1.HEIC").unlink()
    (tmp_path / "IMG_2.heic").unlink()
    with pytest.raises(BadInput, match=r"too few photos \(1\)"):
        inspect_photos(tmp_path)


@pytest.mark.parametrize("locked", ["sparse", "images", ""])
def test_a_folder_that_may_not_be_read_is_not_taken_for_a_missing_one(
    locked: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A model that was not seen would be computed anew from the photos, without a word."""
    write_model(reconstruction(), tmp_path / "sparse", ".bin")
    (tmp_path / "images").mkdir()
    folder, isfile, access = tmp_path / locked, os.path.isfile, os.access
    monkeypatch.setattr(os, "access", lambda path, how: path != folder and access(path, how))
    monkeypatch.setattr(os.path, "isfile", lambda path: folder not in Path(path).parents and isfile(path))
    with pytest.raises(BadInput, match=f"No permission for '{re.escape(str(folder))}'; change its permissions"):
        model = find_model(tmp_path)
        assert model is not None
        find_photos(photo_names(model), model, tmp_path)


def test_a_model_s_own_folder_that_may_not_be_read_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder := tmp_path / "sparse" / "0").mkdir(parents=True)
    access = os.access
    monkeypatch.setattr(os, "access", lambda path, how: path != folder and access(path, how))
    with pytest.raises(BadInput, match=f"No permission for '{re.escape(str(folder))}'"):
        find_model(tmp_path)


def test_photos_in_a_folder_that_may_not_be_read_are_not_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "images").mkdir()
    access = os.access
    monkeypatch.setattr(os, "access", lambda path, how: path != tmp_path / "images" and access(path, how))
    with pytest.raises(BadInput, match="No permission for"):
        list_photos(tmp_path)
