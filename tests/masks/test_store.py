# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks are read as they were written; those of another scene or damaged ones are refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.small_scene import make_scene, view

from mgf_engine.errors import BadInput
from mgf_engine.masks.parts import Part
from mgf_engine.masks.store import label_files, read_masks, read_png, read_up, save_masks, write_image
from mgf_engine.model.masks import IGNORE, MaskSet
from mgf_engine.model.scene import Scene
from mgf_engine.model.up_direction import UpDirection

SCENE = make_scene([view("a.jpg", 0), view("b.jpg", 1)], np.zeros((3, 3)), [[(0, 1, 1)], [(0, 2, 2)], [(1, 3, 3)]])


UP = UpDirection(np.array([0.6, -0.8, 0.0]), 0.0123456789, "walls", 40)


def masks() -> MaskSet:
    first, second = np.zeros((10, 20), np.uint8), np.ones((10, 20), np.uint8)
    first[2:5, 3:9], second[0, 0] = 2, IGNORE
    clicks = (np.array([[1.5, 2.25]], np.float32), np.zeros((0, 2), np.float32))
    return MaskSet((first, second), np.array([True, False]), np.array([0.5, 0.25], np.float32),
                   np.array([True, False, True]), clicks, UP)  # fmt: skip


def test_masks_come_back_as_they_were(tmp_path: Path) -> None:
    given = masks()
    part = Part("door", [(0, 2)], [1])
    save_masks(given, SCENE, tmp_path, ["", "too dark"], {"segmenter": "none"}, [part])
    read = read_masks(tmp_path, SCENE)
    for one, other in zip(given.labels, read.labels, strict=True):
        np.testing.assert_array_equal(one, other)
    for name in ("used", "scores", "point_mask"):
        np.testing.assert_array_equal(getattr(given, name), getattr(read, name))
    for up in (read.up, read_up(tmp_path)):
        assert up is not None and up.vector.tolist() == UP.vector.tolist()
        assert (up.sd, up.method, up.edges) == (UP.sd, "walls", 40)
    assert [c.tolist() for c in read.clicks] == [[[1.5, 2.25]], []] and read.clicked == [0]
    scores = json.loads((tmp_path / "scores.json").read_text())
    assert scores["segmenter"] == "none" and [v["flag"] for v in scores["views"]] == ["", "too dark"]
    assert scores["views"][0]["building"] == pytest.approx(18 / 200)
    parts = json.loads((tmp_path / "parts.json").read_text())["parts"]
    assert parts == [{"name": "door", "elements": [["a.jpg", 2]], "points": [1]}]


def test_masks_of_earlier_versions_know_no_direction_up(tmp_path: Path) -> None:
    save_masks(replace(masks(), up=None), SCENE, tmp_path, ["", ""])
    data = json.loads((tmp_path / "scores.json").read_text())
    assert data.pop("up") is None and read_masks(tmp_path, SCENE).up is None
    (tmp_path / "scores.json").write_text(json.dumps(data))
    assert read_masks(tmp_path, SCENE).up is None
    (tmp_path / "scores.json").write_text(json.dumps({**data, "up": [0.6, -0.8, 0.0]}))  # without its accuracy
    assert read_masks(tmp_path, SCENE).up is None and read_up(tmp_path) is None
    assert read_up(tmp_path / "nowhere") is None


@pytest.mark.parametrize(
    "up",
    [
        "{}", '{"vector": [0, 1], "sd": 0.1, "method": "tags", "edges": 0}',
        '{"vector": [0, 0, 2], "sd": 0.1, "method": "tags", "edges": 0}',
        '{"vector": [0, 0, NaN], "sd": 0.1, "method": "tags", "edges": 0}',
        '{"vector": [0, 0, 1], "sd": -0.1, "method": "tags", "edges": 0}',
        '{"vector": [0, 0, 1], "sd": 0.1, "method": "tags", "edges": "many"}',
        '{"vector": [0, 0, 1], "sd": 0.1, "method": "stars", "edges": 0}',
    ],
)  # fmt: skip
def test_a_direction_up_that_is_none_is_refused(tmp_path: Path, up: str) -> None:
    save_masks(masks(), SCENE, tmp_path, ["", ""])
    data = json.loads((tmp_path / "scores.json").read_text())
    (tmp_path / "scores.json").write_text(json.dumps({**data, "up": "here"}).replace('"here"', up))
    with pytest.raises(BadInput, match="run the masks stage again"):
        read_masks(tmp_path, SCENE)


def test_masks_of_photos_that_are_gone_are_removed(tmp_path: Path) -> None:
    (tmp_path / "labels").mkdir()
    write_image(tmp_path / "labels" / "gone.png", np.zeros((2, 2), np.uint8))
    save_masks(masks(), SCENE, tmp_path, ["", ""])
    assert sorted(p.name for p in (tmp_path / "labels").iterdir()) == ["a.png", "b.png"]


@pytest.mark.parametrize(
    "names,files",
    [
        (["x/a.jpg", "x/b.jpg"], ["labels/a.png", "labels/b.png"]),
        (["x/a.jpg", "y/A.png"], ["labels/x__a.jpg.png", "labels/y__A.png.png"]),
    ],
)
def test_each_photo_has_a_file_of_its_own(names: list[str], files: list[str]) -> None:
    scene = replace(SCENE, views=tuple(view(name, 0) for name in names))
    assert label_files(scene) == files


@pytest.mark.parametrize(
    "scene",
    [
        replace(SCENE, views=(view("a.jpg", 0), view("c.jpg", 1))),
        replace(SCENE, points=np.zeros((2, 3))),
    ],
    ids=["other photos", "other points"],
)
def test_masks_of_another_scene_are_refused(tmp_path: Path, scene: Scene) -> None:
    save_masks(masks(), SCENE, tmp_path, ["", ""])
    with pytest.raises(BadInput, match="belong to another scene"):
        read_masks(tmp_path, scene)


@pytest.mark.parametrize("score", ["NaN", "[1, 2]", '"much"', "null"])
def test_scores_that_are_no_numbers_are_refused(tmp_path: Path, score: str) -> None:
    save_masks(masks(), SCENE, tmp_path, ["", ""])
    text = (tmp_path / "scores.json").read_text()
    (tmp_path / "scores.json").write_text(text.replace('"score": 0.5', f'"score": {score}'))
    assert text != (tmp_path / "scores.json").read_text()
    with pytest.raises(BadInput, match="run the masks stage again"):
        read_masks(tmp_path, SCENE)


def test_a_mask_of_another_size_or_with_colours_is_refused(tmp_path: Path) -> None:
    save_masks(masks(), SCENE, tmp_path, ["", ""])
    for odd in (np.zeros((10, 21), np.uint8), np.zeros((10, 20, 3), np.uint8)):
        write_image(tmp_path / "labels" / "b.png", odd)
        with pytest.raises(BadInput, match="missing, damaged or of another size"):
            read_masks(tmp_path, SCENE)


def test_an_image_of_an_unexpected_size_is_not_decoded(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png", np.full((4, 6), 9, np.uint8))
    found = read_png(tmp_path / "a.png", [(6, 4)])
    assert found is not None and (found == 9).all()
    assert read_png(tmp_path / "a.png", [(4, 6)]) is None
    assert read_png(tmp_path / "none.png") is None
