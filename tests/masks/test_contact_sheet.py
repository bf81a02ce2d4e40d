# SPDX-License-Identifier: GPL-3.0-or-later
"""The contact sheet shows every photo once, with its mask's outline and its flag."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.small_scene import make_scene, view

from mgf_engine.masks.contact_sheet import BAD, CAPTION, GOOD, OUTLINE, TILE, overlay, write_contact_sheet
from mgf_engine.model.masks import BACKGROUND, BUILDING, IGNORE, MaskSet


def test_outside_and_occluders_are_dimmed_and_the_building_is_outlined() -> None:
    photo = np.full((40, 60, 3), (200, 100, 0), np.uint8)
    labels = np.full((40, 60), BACKGROUND, np.uint8)
    labels[10:30, 10:50], labels[10:30, 40:50] = BUILDING, IGNORE
    found = overlay(photo, labels)
    assert found[20, 25].tolist() == [0, 100, 200]  # BGR, as it is
    assert tuple(found[10, 25]) == OUTLINE and tuple(found[20, 39]) == OUTLINE
    outside, occluder = found[2, 2].astype(int), found[20, 45].astype(int)
    np.testing.assert_allclose(outside, [55, 50, 125], atol=1)  # 0.35 of the photo and half of the colour
    np.testing.assert_allclose(occluder, [15, 100, 170], atol=1)
    assert photo[2, 2].tolist() == [200, 100, 0]


@pytest.mark.parametrize("count,columns,rows", [(1, 1, 1), (2, 2, 1), (5, 2, 3), (7, 3, 3)])
def test_a_sheet_has_a_tile_for_each_photo(tmp_path: Path, count: int, columns: int, rows: int) -> None:
    views = [replace(view(f"{k}.png", k), file=f"{k}.png") for k in range(count)]
    scene = replace(make_scene(views, np.zeros((0, 3)), []), folder=tmp_path)
    for k in range(count):
        cv2.imwrite(str(tmp_path / f"{k}.png"), np.full((10, 20, 3), 128, np.uint8))
    labels = tuple(np.ones((10, 20), np.uint8) for _ in views)
    used = np.arange(count) != 0
    masks = MaskSet(labels, used, np.ones(count, np.float32), np.zeros(0, bool))
    reasons = ["weak", *[""] * (count - 1)]
    write_contact_sheet(scene, masks, reasons, {0}, tmp_path / "sheet.png")
    sheet = cv2.imread(str(tmp_path / "sheet.png"))
    assert sheet is not None
    height = TILE // 2 + CAPTION
    assert sheet.shape == (rows * height, columns * TILE, 3)
    for k in range(columns * rows):
        top, left = k // columns * height, k % columns * TILE
        picture, caption = np.split(sheet[top : top + height, left : left + TILE], [TILE // 2])
        assert picture.any() == (k < count)
        brightest = caption.reshape(-1, 3).max(0)
        wanted = (0, 0, 0) if k >= count else GOOD if used[k] else BAD
        np.testing.assert_allclose(brightest, wanted, atol=3)
