# SPDX-License-Identifier: GPL-3.0-or-later
"""Clicks made from true masks."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np

from benchmarks.prompts import click_prompts, inside_points, spread_photos


def test_points_lie_well_inside_their_region() -> None:
    region = np.zeros((120, 200), bool)
    region[20:100, 30:170] = True
    points = inside_points(region, 3)
    assert len(points) == 3
    depth = cv2.distanceTransform(region.astype(np.uint8), cv2.DIST_L2, 5)
    for u, v in points:
        assert depth[int(v), int(u)] > 10
    assert np.linalg.norm(np.subtract(points[0], points[1])) > 30


def test_nothing_to_click_gives_no_point() -> None:
    assert inside_points(np.zeros((20, 20), bool), 3) == []
    thin = np.zeros((20, 20), bool)
    thin[5] = True
    assert inside_points(thin, 3) == []


def test_photos_are_spread_around_the_orbit() -> None:
    angles = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    centres = np.stack([np.cos(angles), np.sin(angles), np.zeros(20)], 1) * 30
    chosen = spread_photos(np.concatenate([centres, -centres / 30], 1), 4)
    assert len(chosen) == 4
    assert np.diff([*chosen, chosen[0] + 20]).min() >= 4


def test_the_file_has_clicks_for_a_fifth_of_the_photos(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    labels = [np.zeros((60, 90), np.uint8) for _ in range(10)]
    for label in labels:
        label[15:45, 20:70] = 1
        label[15:45, 60:70] = 255
    click_prompts(tmp_path / "prompts.json", [f"p{i}.jpg" for i in range(10)], rng.random((10, 6)), labels)
    prompts = json.loads((tmp_path / "prompts.json").read_text())
    assert len(prompts) == 3
    for entry in prompts.values():
        assert entry["positive"] and entry["negative"]
        assert all(labels[0][int(v), int(u)] == 1 for u, v in entry["positive"])
        assert all(labels[0][int(v), int(u)] == 0 for u, v in entry["negative"])
