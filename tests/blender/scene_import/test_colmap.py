# SPDX-License-Identifier: GPL-3.0-or-later
"""The numpy reader of COLMAP models: right numbers from good files, one sentence from bad ones."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
import synthetic
from support.foreign_names import ANSI, ANSI_NAME, PLAIN
from support.model_places import SEVERAL, write_project

from mgf_blender.common.errors import UserError
from mgf_blender.scene_import.colmap import make_camera, quaternion_to_matrix, read_model
from mgf_blender.scene_import.imported_scene import ImportedScene
from mgf_blender.scene_import.locate import find_model, find_photo, find_photo_folder, plain_name


def assert_sentence(error: UserError) -> None:
    text = str(error)
    assert text[0].isupper() or text[0] == "'"
    assert text.endswith(".") and "\n" not in text and "Traceback" not in text


@pytest.mark.parametrize("text", [False, True], ids=["bin", "txt"])
def test_reads_what_was_written(tmp_path, text):
    house = synthetic.write_house(tmp_path / "house", text=text)
    model = read_model(find_model(house.folder))
    assert [p.name for p in model.photos] == sorted(house.poses)
    for photo in model.photos:
        _, rotation, translation = house.poses[photo.name]
        np.testing.assert_allclose(photo.rotation, rotation, atol=1e-12)
        np.testing.assert_allclose(photo.translation, translation, atol=1e-12)
    np.testing.assert_array_equal(model.points.xyz, house.xyz)
    np.testing.assert_array_equal(model.points.rgb, house.rgb)
    assert set(model.points.track_length) == {2} and set(model.points.error) == {0.25}


@pytest.mark.parametrize("text", [False, True], ids=["bin", "txt"])
@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
def test_cut_files_say_so(tmp_path, name, text):
    house = synthetic.write_house(tmp_path / "house", text=text)
    path = house.model / (name + (".txt" if text else ".bin"))
    whole = path.read_bytes()
    refused = 0
    cuts = range(0, len(whole), 1 if name == "cameras" else 61)
    for cut in cuts:
        path.write_bytes(whole[:cut])
        try:
            read_model(house.model)
        except UserError as error:
            assert_sentence(error)
            refused += 1
    # A text file may be cut at the end of a line and is then simply shorter; a binary file is always refused.
    assert refused == len(cuts) if not text else refused > 0


def test_noise_never_escapes_as_another_error(tmp_path):
    house = synthetic.write_house(tmp_path / "house")
    random = np.random.default_rng(3)
    for name in ("cameras.bin", "images.bin", "points3D.bin"):
        whole = (house.model / name).read_bytes()
        for _ in range(150):
            data = bytearray(whole)
            for at in random.integers(0, len(data), 3):
                data[at] = random.integers(0, 256)
            (house.model / name).write_bytes(data)
            try:
                read_model(house.model)
            except UserError as error:
                assert_sentence(error)
        (house.model / name).write_bytes(whole)


def test_missing_pieces(tmp_path):
    with pytest.raises(UserError, match="does not exist"):
        find_model(tmp_path / "nowhere")
    with pytest.raises(UserError, match="holds no COLMAP model"):
        find_model(tmp_path)
    house = synthetic.write_house(tmp_path / "house")
    (house.model / "images.bin").write_bytes(b"\0" * 8)
    with pytest.raises(UserError, match="no registered photos"):
        read_model(house.model)


def test_nan_pose_and_unknown_model(tmp_path):
    house = synthetic.write_house(tmp_path / "house", text=True)
    path = house.model / "images.txt"
    lines = path.read_text().splitlines()
    words = lines[1].split()
    lines[1] = " ".join([words[0], "nan", *words[2:]])
    path.write_text("\n".join(lines))
    with pytest.raises(UserError, match="pose of the photo"):
        read_model(house.model)
    with pytest.raises(UserError, match="not supported"):
        make_camera("PANORAMA", 10, 10, (1.0,))


@pytest.mark.parametrize(
    ("model", "params", "distorted"),
    [
        ("SIMPLE_RADIAL", (500, 320, 240, 0.0), False),
        ("RADIAL", (500, 320, 240, 0.01, 0.0), True),
        ("OPENCV", (500, 510, 320, 240, 0, 0, 0, 1e-4), True),
        ("OPENCV_FISHEYE", (500, 510, 320, 240, 0, 0, 0, 0), True),
        ("FOV", (500, 510, 320, 240, 0.0), True),
        ("FULL_OPENCV", (500, 510, 320, 240, *([0] * 8)), False),
    ],
)
def test_distortion_is_noticed(model, params, distorted):
    camera = make_camera(model, 640, 480, params)
    assert camera.distorted is distorted
    assert (camera.cx, camera.cy) == (320, 240)


def test_layouts(tmp_path):
    house = synthetic.write_house(tmp_path / "house")
    for path in (house.folder, house.folder / "sparse", house.model, house.model / "images.bin"):
        assert find_model(path) == house.model
        assert find_photo_folder(path, house.model, list(house.poses)) == house.folder / "images"


@pytest.mark.parametrize(("name", "windows", "plain"), PLAIN)
def test_names_never_lead_to_another_machine(name, windows, plain):
    assert plain_name(name, windows) == plain


def test_a_photo_whose_name_is_a_whole_path_is_looked_for_in_the_photo_folder_alone(tmp_path):
    elsewhere, here = tmp_path / "elsewhere" / "a.png", tmp_path / "photos" / "a.png"
    for path in (elsewhere, here):
        synthetic.write_png(path, np.zeros((8, 8, 3), np.uint8))
    assert find_photo(here.parent, str(elsewhere)) == here
    here.unlink()
    assert find_photo(here.parent, str(elsewhere)) is None


@pytest.mark.parametrize("text", [False, True], ids=["bin", "txt"])
def test_photo_names_that_are_not_utf8(addon, tmp_path, text):
    """COLMAP on Windows writes names in the code page; add-on and engine must read the same."""
    house = synthetic.write_house(tmp_path / "house", text=text)
    old = next(iter(house.poses))
    images = house.model / ("images.txt" if text else "images.bin")
    images.write_bytes(images.read_bytes().replace(old.encode(), b"wing/" + ANSI))
    new = f"wing/{ANSI_NAME}"
    (house.folder / "images" / old).rename(house.folder / "images" / new)
    assert new in [p.name for p in read_model(house.model).photos]
    assert bpy.ops.mgf.import_colmap(filepath=str(house.folder)) == {"FINISHED"}
    cameras = {o.get("mgf_photo"): o for o in ImportedScene.find(bpy.context.scene).objects("Cameras")}
    assert len(cameras) == 12 and cameras[new].data.background_images[0].image.size[0] > 0


@pytest.mark.parametrize(("models", "taken"), SEVERAL.values(), ids=list(SEVERAL))
def test_one_of_several_models_is_taken_as_by_the_engine(models, taken, tmp_path):
    write_project(tmp_path, models)
    assert find_model(tmp_path) == tmp_path / taken


def test_a_damaged_model_does_not_win_over_a_sound_one(tmp_path):
    write_project(tmp_path, {"sparse/0": 6, "sparse/1": 3})
    (tmp_path / "sparse" / "0" / "images.txt").unlink()
    (tmp_path / "sparse" / "0" / "images.bin").write_bytes(b"\xff" * 40)
    (tmp_path / "sparse" / "0" / "cameras.bin").write_bytes(b"\xff" * 40)
    (tmp_path / "sparse" / "0" / "points3D.bin").write_bytes(b"\xff" * 40)
    assert find_model(tmp_path) == tmp_path / "sparse" / "1"


def test_quaternions_of_any_length():
    half = quaternion_to_matrix(np.array([2.0, 0, 0, 2.0]))
    np.testing.assert_allclose(half @ (1, 0, 0), (0, 1, 0), atol=1e-15)
