# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos to paint with: the user's own in the exposure of the working ones, which stand in where those are gone."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from support.small_scene import view

from mgf_engine.texture.painting import Originals

WORKING = np.full((10, 20, 3), 7, np.uint8)


def test_the_users_photo_comes_in_the_exposure_of_the_working_ones(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    cv2.imwrite(str(path), np.full((10, 20, 3), (30, 20, 10), np.uint8))  # BGR
    plain = view("a.png", 0, photo=str(path))
    originals = Originals([plain, view("b.png", 0, photo=str(path), gain=(2.0, 1.5, 1.0))], lambda k: WORKING)
    first, second = originals(0), originals(1)
    assert first.original and first.image[0, 0].tolist() == [10, 20, 30]
    assert second.original and second.image[0, 0].tolist() == [20, 30, 30]
    assert not originals.gone


def test_for_one_that_is_gone_or_another_the_working_photo_stands_in(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "other.png"), np.zeros((3, 3, 3), np.uint8))
    views = [view("a", 0, photo=str(tmp_path / name)) for name in ("gone.png", "other.png")]
    originals = Originals([*views, view("c", 0)], lambda k: WORKING + np.uint8(k))
    for k in range(3):
        found = originals(k)
        assert not found.original and (found.image == 7 + k).all()
    assert len(originals.gone) == 3 and "gone.png" in originals.gone[0] and "has changed" in originals.gone[1]
