# SPDX-License-Identifier: GPL-3.0-or-later
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.small_scene import make_scene, view

from mgf_engine.errors import BadInput
from mgf_engine.masks.user_masks import read_user_masks, to_labels
from mgf_engine.model.scene import Scene

WHERE = Path("mask.png")


def square(value: int = 255, kind: type = np.uint8) -> np.ndarray:
    mask = np.zeros((20, 40), kind)
    mask[5:15, 10:30] = value
    return mask


@pytest.fixture
def scene() -> Scene:
    wide = {"original_width": 40, "original_height": 20}
    return make_scene([view("a/one.jpg", 0, **wide), view("two.jpg", 0, **wide)], np.zeros((0, 3)), [])


def save(folder: Path, name: str, image: np.ndarray) -> None:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(cv2.imencode(".png", image)[1].tobytes())


@pytest.mark.parametrize("value", [1, 128, 255])
def test_two_grey_values(value: int):
    assert (to_labels(square(value), WHERE) == (square() > 0)).all()


def test_sixteen_bit():
    assert (to_labels(square(65535, np.uint16), WHERE) == (square() > 0)).all()
    assert (to_labels(square(1, np.uint16), WHERE) == (square() > 0)).all()


def test_soft_edges_are_cut_at_half():
    soft = cv2.GaussianBlur(square(), (0, 0), 1.0)
    assert (to_labels(soft, WHERE) == (soft >= soft.max() / 2)).all()


def test_label_maps_stay_as_they_are():
    labels = square(1)
    labels[7:9, 12:15], labels[0, 0] = 7, 255
    assert (to_labels(labels, WHERE) == labels).all()


def test_alpha_wins_over_color():
    image = np.full((20, 40, 4), 90, np.uint8)
    image[..., 3] = square()
    assert (to_labels(image, WHERE) == (square() > 0)).all()
    image[..., :3], image[..., 3] = square()[..., None], 255
    assert (to_labels(image, WHERE) == (square() > 0)).all()


def test_color_masks():
    image = np.zeros((20, 40, 3), np.uint8)
    image[5:15, 10:20] = (0, 0, 200)
    image[5:15, 20:30] = (0, 90, 0)
    assert (to_labels(image, WHERE) == (square() > 0)).all()
    image[~(square() > 0)] = (9, 0, 0)
    with pytest.raises(BadInput, match="no black"):
        to_labels(image, WHERE)


def test_palette_files(tmp_path: Path, scene: Scene):
    from PIL import Image

    picture = Image.fromarray((square() > 0).astype(np.uint8), "P")
    picture.putpalette([0, 0, 0, 220, 20, 60])
    picture.save(tmp_path / "two.png")
    assert (read_user_masks(tmp_path, scene)[1] == (square()[1::2, 1::2] > 0)).all()


def test_float_pixels_are_refused():
    with pytest.raises(BadInput, match="8-bit grey"):
        to_labels(square().astype(np.float32), WHERE)


@pytest.mark.parametrize("name", ["a/one.png", "a/one.jpg.png", "one.png", "one.jpg.png"])
def test_names_and_scaling(tmp_path: Path, scene: Scene, name: str):
    save(tmp_path, name, square())
    first, second = read_user_masks(tmp_path, scene)
    assert second is None and first is not None
    assert first.shape == (10, 20) and first.dtype == np.uint8
    assert first.sum() == 50


def test_masks_of_the_working_photo_are_taken_as_they_are(tmp_path: Path, scene: Scene):
    small = square()[::2, ::2].copy()
    save(tmp_path, "one.png", small)
    assert (read_user_masks(tmp_path, scene)[0] == (small > 0)).all()


def test_refusals(tmp_path: Path, scene: Scene):
    with pytest.raises(BadInput, match="does not exist"):
        read_user_masks(tmp_path / "none", scene)
    with pytest.raises(BadInput, match="fits a photo; name each like its photo"):
        read_user_masks(tmp_path, scene)
    save(tmp_path, "one.png", np.zeros((20, 40), np.uint8))
    with pytest.raises(BadInput, match="is empty"):
        read_user_masks(tmp_path, scene)
    save(tmp_path, "one.png", np.full((20, 40), 255, np.uint8))
    with pytest.raises(BadInput, match="covers its whole photo"):
        read_user_masks(tmp_path, scene)
    save(tmp_path, "one.png", square()[:, :39])
    with pytest.raises(BadInput, match=r"39 x 20 pixels, but its photo has 40 x 20"):
        read_user_masks(tmp_path, scene)
    (tmp_path / "one.png").write_bytes(b"not a picture")
    with pytest.raises(BadInput, match="cannot be read"):
        read_user_masks(tmp_path, scene)
    (tmp_path / "one.png").write_bytes(b"")
    with pytest.raises(BadInput, match="cannot be read"):
        read_user_masks(tmp_path, scene)
