# SPDX-License-Identifier: GPL-3.0-or-later
"""CIELAB of photos, converted once for all that compare them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.small_scene import make_scene, view

from mgf_engine.masks.refinement import lab_photos
from mgf_engine.masks.refinement.lab_photos import LabPhotos

#: RGB -> OpenCV's 8-bit CIELAB: lightness times 2.55, a and b plus 128.
COLORS = {(255, 255, 255): (255, 128, 128), (0, 0, 0): (0, 128, 128), (255, 0, 0): (136, 208, 195)}


@pytest.fixture
def photos(tmp_path: Path) -> LabPhotos:
    views = [replace(view(f"{k}.png", 0), file=f"{k}.png") for k in range(len(COLORS))]
    for one, color in zip(views, COLORS, strict=True):
        cv2.imwrite(str(tmp_path / one.file), np.full((4, 6, 3), color[::-1], np.uint8))
    return LabPhotos(replace(make_scene(views, np.zeros((1, 3)), [[]]), folder=tmp_path))


@pytest.mark.parametrize("index", range(len(COLORS)))
def test_colors_are_converted(photos: LabPhotos, index: int) -> None:
    wanted = list(COLORS.values())[index]
    assert photos.lab(index).shape == (4, 6, 3) and (photos.lab(index) == wanted).all()
    assert photos.lightness(index).shape == (4, 6) and (photos.lightness(index) == wanted[0]).all()


def test_a_photo_is_converted_once_and_cannot_be_written_to(photos: LabPhotos, monkeypatch) -> None:
    first = photos.lab(1)
    monkeypatch.setattr(lab_photos, "cv2", None)
    assert photos.lab(1) is first and not first.flags.writeable
