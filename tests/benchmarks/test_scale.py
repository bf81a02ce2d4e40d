# SPDX-License-Identifier: GPL-3.0-or-later
"""The measure of how work grows: larger photos stay the same scene, and charts show whatever was measured."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import pycolmap
import pytest

from benchmarks.stability_scale import chart, enlarged, masked_iteration
from benchmarks.synthetic.house import WIDTH, build_house


def test_larger_photos_show_the_same_scene(tmp_path: Path) -> None:
    house = build_house(tmp_path / "house", 4)
    large = enlarged(house.folder, tmp_path / "large", 2 * WIDTH)
    photo = cv2.imread(str(next(iter(sorted((large / "images").iterdir())))))
    assert photo.shape[1] == 2 * WIDTH
    model = pycolmap.Reconstruction(str(large / "sparse" / "0"))
    assert model.cameras[1].width == 2 * WIDTH
    assert model.compute_mean_reprojection_error() < 0.5
    for point in model.points3D.values():
        for element in point.track.elements:
            image = model.images[element.image_id]
            seen, there = image.points2D[element.point2D_idx].xy, image.project_point(point.xyz)
            assert there == pytest.approx(seen, abs=0.5)
    clicks, larger = (json.loads((folder / "prompts.json").read_text()) for folder in (house.folder, large))
    name = next(iter(clicks))
    assert larger[name]["positive"][0] == pytest.approx([2 * v for v in clicks[name]["positive"][0]])


def test_a_chart_shows_what_was_measured(tmp_path: Path) -> None:
    job = {"cpu": {"masks": 3.0, "field": 5.0}, "memory": 1e9}
    found = {"photos": {"20": job, "60": job}, "pixels": {}, "gaussians": {"1000": {"cpu": {"blend": 2.0}}}}
    found["shares"] = {"0.25": {"cpu": {"blend": 2.0}, "pairs": 7e6}, "1.0": {"cpu": {"blend": 5.0}, "pairs": 3e7}}
    chart(found, tmp_path / "scale.png")
    picture = cv2.imread(str(tmp_path / "scale.png"))
    assert picture.shape[1] == pytest.approx(1320, abs=2)


def test_a_mask_takes_pairs_and_work_away() -> None:
    whole, part = masked_iteration(1.0), masked_iteration(0.06)
    assert part["pairs"] < 0.5 * whole["pairs"]
    assert part["cpu"]["blend backward"] < 0.7 * whole["cpu"]["blend backward"]
