# SPDX-License-Identifier: GPL-3.0-or-later
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support.small_scene import make_scene, view

from mgf_engine.errors import BadInput
from mgf_engine.files.images import write_png
from mgf_engine.masks.prompts import PromptsFile, check_prompts, read_prompts
from mgf_engine.model.scene import Lens, Scene
from mgf_engine.scene.cameras import to_original


@pytest.fixture
def scene() -> Scene:
    wide = {"original_width": 40, "original_height": 20}
    views = [view("east/IMG_1.JPG", 0, **wide), view("west/IMG_1.JPG", 0, **wide), view("west/Tür 2.jpg", 0, **wide)]
    return make_scene(views, np.zeros((0, 3)), [])


def write(tmp_path: Path, data: object) -> Path:
    path = tmp_path / "prompts.json"
    path.write_text(data if isinstance(data, str) else json.dumps(data), encoding="utf-8")
    return path


def test_clicks_come_in_working_pixels(tmp_path: Path, scene: Scene):
    data = {"west/Tür 2.jpg": {"positive": [[20, 10], [40, 20]], "negative": [[1, 2.5]], "parts": {"door": [[4, 4]]}}}
    clicks = read_prompts(write(tmp_path, data), scene)[2]
    assert clicks.positive[0].tolist() == [10, 5]
    assert clicks.positive[1] == pytest.approx([20, 10], abs=0.01) and (clicks.positive[1] < [20, 10]).all()
    assert clicks.negative.tolist() == [[0.5, 1.25]]
    assert clicks.parts["door"].tolist() == [[2, 2]]


def test_distorted_photos(tmp_path: Path, scene: Scene):
    lens = Lens("SIMPLE_RADIAL", 40, 20, (20.0, 20.0, 10.0, -0.2))
    bent = replace(scene.views[2], lens=lens)
    scene = replace(scene, views=(*scene.views[:2], bent))
    data = {"Tür 2.jpg": {"positive": [[30, 10]]}}
    clicks = read_prompts(write(tmp_path, data), scene)[2]
    back = to_original(bent, clicks.positive)
    assert np.allclose(back, [[30, 10]], atol=1e-6)
    assert abs(clicks.positive[0, 0] - 15) > 0.05  # not the mere scaling


@pytest.mark.parametrize(
    "name", ["west/Tür 2.jpg", "Tür 2.jpg", "WEST/TÜR 2.JPG", "tür 2.JPG", "west\\Tür 2.jpg", "Tür 2.png"]
)
def test_names_match_with_and_without_folder_case_and_ending(tmp_path: Path, scene: Scene, name: str):
    assert set(read_prompts(write(tmp_path, {name: {"positive": [[1, 1]]}}), scene)) == {2}


def test_clicks_on_a_photo_that_lies_there_but_was_not_placed_are_passed_over(tmp_path: Path, scene: Scene):
    photos = tmp_path / "photos"
    for name in ("west/unplaced.jpg", *(v.name for v in scene.views)):
        (photos / name).parent.mkdir(parents=True, exist_ok=True)
        (photos / name).write_bytes(b"")
    (tmp_path / "outside.jpg").write_bytes(b"")
    scene = replace(scene, views=tuple(replace(v, photo=str(photos / v.name)) for v in scene.views))
    clicks = {"west/Tür 2.jpg": {"positive": [[1, 1]]}, "west/unplaced.jpg": {"positive": [[1, 1]]}}
    warnings: list[str] = []
    assert set(read_prompts(write(tmp_path, clicks), scene, warnings.append)) == {2}
    assert len(warnings) == 1 and warnings[0].startswith("1 of 2 photos") and "'west/unplaced.jpg'" in warnings[0]
    with pytest.raises(BadInput, match="No photo with clicks"):
        read_prompts(write(tmp_path, {"west/unplaced.jpg": {"positive": [[1, 1]]}}), scene)
    left_out = replace(scene, left_out=("west/unplaced.jpg",))
    assert set(read_prompts(write(tmp_path, clicks), left_out, warnings.append)) == {2} and len(warnings) == 1
    with pytest.raises(BadInput, match=r"All photos with clicks in .* were left out of the scene"):
        read_prompts(write(tmp_path, {"west/unplaced.jpg": {"positive": [[1, 1]]}}), left_out)
    for name in ("west/gone.jpg", "../outside.jpg", str(tmp_path / "outside.jpg"), "x" * 5000, "a\0b"):
        with pytest.raises(BadInput, match="does not have"):
            read_prompts(write(tmp_path, {name: {"positive": [[1, 1]]}}), scene)


BAD = [
    ('{"a"', "not valid JSON"),
    ("[1]", "one entry per photo"),
    ("[" * 100_000, "not valid JSON"),
    ({"other.jpg": {"positive": [[1, 1]]}}, "'other.jpg', which the scene does not have"),
    ({"IMG_1.JPG": {"positive": [[1, 1]]}}, "could be any of east/IMG_1.JPG, west/IMG_1.JPG"),
    ({"Tür 2.jpg": {"positive": [[1, 1]]}, "west/Tür 2.jpg": {"positive": [[1, 1]]}}, "two entries"),
    ('{"Tür 2.jpg": {"positive": [[1, 1]]}, "Tür 2.jpg": {}}', "twice"),
    ({"Tür 2.jpg": {"positive": [[41, 1]]}}, "(41, 1) outside the photo, which has 40 x 20 pixels"),
    ({"Tür 2.jpg": {"negative": [[3, -1]]}}, "(3, -1) outside"),
    ('{"Tür 2.jpg": {"positive": [[NaN, 1]]}}', "outside"),
    ('{"Tür 2.jpg": {"positive": [[1e999, 1]]}}', "outside"),
    ({"Tür 2.jpg": {"positive": [[1]]}}, "not a pair of numbers"),
    ({"Tür 2.jpg": {"positive": [["1", 2]]}}, "not a pair of numbers"),
    ({"Tür 2.jpg": {"positive": [[True, 2]]}}, "not a pair of numbers"),
    ({"Tür 2.jpg": {"positive": 7}}, "list of [u, v] pairs"),
    ({"Tür 2.jpg": [[1, 2]]}, "should be an object"),
    ({"Tür 2.jpg": {"positiv": [[1, 2]]}}, "'positiv'"),
    ({"Tür 2.jpg": {"parts": [[1, 2]]}}, "'parts'"),
    ({"Tür 2.jpg": {"parts": {"door": [[99, 2]]}}}, "The part 'door'"),
    ({"Tür 2.jpg": {"negative": [[1, 2]]}}, "no click on the building"),
    ({}, "no click on the building"),
]


@pytest.mark.parametrize(("data", "part"), BAD)
def test_bad_files_say_what_is_wrong(tmp_path: Path, scene: Scene, data: object, part: str):
    path = write(tmp_path, data)
    with pytest.raises(BadInput) as error:
        read_prompts(path, scene)
    assert part in str(error.value) and str(path) in str(error.value)


#: What only the scene tells: which of two entries names which photo.
_NEEDS_THE_SCENE = {"two entries"}


@pytest.mark.parametrize(("data", "part"), [case for case in BAD if case[1] not in _NEEDS_THE_SCENE])
def test_bad_files_are_refused_before_there_is_a_scene(tmp_path: Path, scene: Scene, data: object, part: str):
    photos = {v.name: tmp_path / f"{index}.png" for index, v in enumerate(scene.views)}
    for v in scene.views:
        write_png(photos[v.name], np.zeros((v.original_height, v.original_width, 3), np.uint8))
    path = write(tmp_path, data)
    with pytest.raises(BadInput) as error:
        check_prompts(PromptsFile.read(path), photos)
    assert part in str(error.value) and str(path) in str(error.value)


def test_good_clicks_pass_before_there_is_a_scene(tmp_path: Path):
    path = write(tmp_path, {"unplaced.jpg": {"positive": [[1, 1]], "parts": {"door": [[2, 2]]}}})
    write_png(tmp_path / "unplaced.jpg", np.zeros((4, 4, 3), np.uint8))
    check_prompts(PromptsFile.read(path), {"unplaced.jpg": tmp_path / "unplaced.jpg"})
    for placed in (False, True):
        with pytest.raises(BadInput, match="does not have"):
            check_prompts(PromptsFile.read(path), {"other.jpg": tmp_path / "photos" / "other.jpg"}, placed=placed)


def test_clicks_on_a_photo_beside_the_model_pass_before_there_is_a_scene(tmp_path: Path):
    """It could not be placed; the masks stage says that its clicks are ignored."""
    path = write(tmp_path, {"beside.png": {"positive": [[1, 1]]}})
    write_png(tmp_path / "beside.png", np.zeros((4, 4, 3), np.uint8))
    photos = {"other.jpg": tmp_path / "other.jpg"}
    check_prompts(PromptsFile.read(path), photos, placed=True)
    with pytest.raises(BadInput, match="does not have"):
        check_prompts(PromptsFile.read(path), photos)


@pytest.mark.parametrize(("orientation", "fine", "wrong"), [(1, [39, 1], [1, 39]), (6, [1, 39], [41, 41])])
def test_clicks_outside_a_photo_of_a_model_are_refused_before_there_is_a_scene(
    tmp_path: Path, orientation: int, fine: list[int], wrong: list[int]
):
    """How a model's photo was turned, the scene stage finds; before it only what is outside either way is wrong."""
    image = Image.new("RGB", (40, 30))
    exif = image.getexif()
    exif[274] = orientation
    image.save(tmp_path / "a.jpg", exif=exif.tobytes())
    photos = {"a.jpg": tmp_path / "a.jpg"}
    check_prompts(PromptsFile.read(write(tmp_path, {"a.jpg": {"positive": [fine]}})), photos, placed=True)
    with pytest.raises(BadInput, match="outside the photo"):
        check_prompts(PromptsFile.read(write(tmp_path, {"a.jpg": {"positive": [wrong]}})), photos, placed=True)


def test_clicks_on_a_turned_photo_without_a_model_are_in_its_stored_pixels(tmp_path: Path, scene: Scene):
    """Structure from motion sees those, and so does Blender."""
    image = Image.new("RGB", (40, 20))
    exif = image.getexif()
    exif[274] = 8
    image.save(tmp_path / "a.jpg", exif=exif.tobytes())
    photos = {"a.jpg": tmp_path / "a.jpg"}
    check_prompts(PromptsFile.read(write(tmp_path, {"a.jpg": {"positive": [[39, 1]]}})), photos)
    outside = write(tmp_path, {"a.jpg": {"positive": [[1, 39]]}})
    sentence = "which has 40 x 20 pixels as stored, before its EXIF orientation turns it; click inside it"
    with pytest.raises(BadInput, match=sentence):
        check_prompts(PromptsFile.read(outside), photos)
    turned = replace(scene, views=tuple(replace(v, name="a.jpg", held=8) for v in scene.views[:1]))
    with pytest.raises(BadInput, match=sentence):
        read_prompts(outside, turned)


def test_clicks_on_a_damaged_photo_pass_before_there_is_a_scene(tmp_path: Path):
    """The scene stage goes on without the photo, so the size it should have is not asked for."""
    (tmp_path / "damaged.jpg").write_bytes(b"no picture")
    path = write(tmp_path, {"damaged.jpg": {"positive": [[5000, 1]]}})
    check_prompts(PromptsFile.read(path), {"damaged.jpg": tmp_path / "damaged.jpg"})
    Image.new("RGB", (40, 30)).save(tmp_path / "damaged.jpg")
    with pytest.raises(BadInput, match="outside the photo"):
        check_prompts(PromptsFile.read(path), {"damaged.jpg": tmp_path / "damaged.jpg"})


def test_missing_and_binary_files(tmp_path: Path, scene: Scene):
    with pytest.raises(BadInput, match=r"Cannot read .*; check the path"):
        read_prompts(tmp_path / "none.json", scene)
    path = tmp_path / "binary.json"
    path.write_bytes(b"\xff\xfe\x00\x80\x81")
    with pytest.raises(BadInput, match="not valid JSON"):
        read_prompts(path, scene)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le"])
def test_files_of_windows_editors_and_of_powershell_are_read(tmp_path: Path, scene: Scene, encoding: str):
    path = tmp_path / "prompts.json"
    path.write_text('{"west/Tür 2.jpg": {"positive": [[20, 10]]}}', encoding=encoding)
    assert read_prompts(path, scene)[2].positive.tolist() == [[10, 5]]


def test_a_file_far_too_large_for_clicks_is_refused_unread(tmp_path: Path, scene: Scene):
    path = tmp_path / "video.mp4"
    with path.open("wb") as file:
        file.truncate(1 << 40)  # takes no room on disk
    with pytest.raises(BadInput, match="1048576 MB"):
        read_prompts(path, scene)


def test_clicks_on_photos_that_were_left_out_are_passed_over(tmp_path: Path, scene: Scene):
    scene = replace(scene, left_out=("north/IMG_1.JPG",))
    data = {"north/IMG_1.JPG": {"positive": [[5, 5]]}, "Tür 2.jpg": {"positive": [[30, 10]]}}
    assert set(read_prompts(write(tmp_path, data), scene)) == {2}
