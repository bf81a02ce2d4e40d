# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.errors import BadInput
from mgf_engine.model.scene import Similarity
from mgf_engine.scene.crop import CropBox, parse_crop_box, read_crop_box


def turned(angle: float = 0.6) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def test_six_numbers_are_the_corners():
    box = parse_crop_box("-1 0, 2\n3 4 5")
    points = np.array([[0.0, 2, 3], [-1, 0, 2], [3, 4, 5], [3.01, 2, 3], [0, 2, 1.99]])
    assert box.contains(points).tolist() == [True, True, True, False, False]
    assert box.contains(points, grow=0.05).tolist() == [True] * 5


def test_sixteen_numbers_are_a_turned_box():
    matrix = np.eye(4)
    matrix[:3, :3] = turned() * (3.0, 1.0, 2.0)
    matrix[:3, 3] = 10, 20, 30
    box = parse_crop_box(" ".join(repr(float(v)) for v in matrix.ravel()))
    assert box.contains(matrix[:3, 3] + turned()[:, [0]].T * [[2.9], [3.1]]).tolist() == [True, False]
    assert box.contains(matrix[:3, 3] + turned()[:, [1]].T * [[0.9], [1.1]]).tolist() == [True, False]
    for n in box.planes():
        distance = matrix[:3, 3] @ n[:3] + n[3]
        assert distance == pytest.approx(1.0)  # the middle is as far inside each plane


def test_the_normalised_box_holds_the_same_points():
    frame = Similarity(0.3, turned(1.1), np.array([4.0, -5.0, 6.0]))
    box = parse_crop_box("-1 -2 -3 4 5 6")
    points = np.random.default_rng(0).uniform(-8, 8, (500, 3))
    inside = box.contains(points)
    assert 0 < inside.sum() < 500
    np.testing.assert_array_equal(box.normalised(frame).contains(frame.apply(points)), inside)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1 2 3", "has 3 numbers"),
        ("1 2 3 4 5 nan", "not finite"),
        ("1 2 3 4 5 1e999", "not finite"),
        ("0 0 0 1 1 1e200", "too large"),
        ("0 0 0 1 1 0", "flat"),
        ("1 0 0 0 1 0 0 0 0 0 1 0 0 0 0 1", "flat"),
        (" ".join(["1"] * 16), "last row"),
        ("/nowhere/box.txt", "Cannot read"),
        ("nonsense", "Cannot read"),
    ],
)
def test_bad_boxes_are_one_sentence(text, words):
    with pytest.raises(BadInput, match=words) as caught:
        read_crop_box(text)
    assert str(caught.value).endswith("or a file.") and "\n" not in str(caught.value)


def test_files_of_windows_editors_are_read(tmp_path):
    (tmp_path / "box.txt").write_bytes(b"\xef\xbb\xbf0 0 0 1 1 1\r\n")
    assert read_crop_box(str(tmp_path / "box.txt")) == "0 0 0 1 1 1"


def test_files_and_none(tmp_path):
    (tmp_path / "box.json").write_text("[[-1, -2e0, -3],\n [1, 2, 3]]")
    text = read_crop_box(str(tmp_path / "box.json"))
    assert text == "-1 -2e0 -3 1 2 3" and read_crop_box(text) == text
    assert isinstance(parse_crop_box(text), CropBox)
    assert read_crop_box("  ") == "" and parse_crop_box("") is None
