# SPDX-License-Identifier: GPL-3.0-or-later
"""Edges of photos, and photos that have none near the building."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from mgf_engine.model.masks import BACKGROUND
from mgf_engine.start.segments import SegmentOptions, _detect


def test_a_photo_whose_edges_all_lie_beside_the_building() -> None:
    photo = np.full((80, 120, 3), 200, np.uint8)
    photo[20:60, 70:110] = 40
    labels = np.full((80, 120), BACKGROUND, np.uint8)
    views: Any = SimpleNamespace(photo=lambda number: photo, labels=[labels])
    ends, sides = _detect(views, 0, SegmentOptions(), 0.0)
    assert ends.shape == (0, 4) and sides.shape == (0, 2, 3)
    labels[20:60, 70:110] = BACKGROUND + 1
    ends, sides = _detect(views, 0, SegmentOptions(), 0.0)
    assert len(ends) >= 4 and len(sides) == len(ends) and (sides[:, 0, 0] >= sides[:, 1, 0]).all()


def test_a_blurred_photo_shows_the_outline_and_not_the_pattern_in_it() -> None:
    photo = np.full((120, 160, 3), 200, np.uint8)
    photo[30:90, 40:120] = 60
    photo[30:90, 40:120:4] = 130  # stripes a pixel wide
    labels = np.full((120, 160), BACKGROUND + 1, np.uint8)
    views: Any = SimpleNamespace(photo=lambda number: photo, labels=[labels])

    def inside(ends: np.ndarray) -> int:
        middle = (ends[:, :2] + ends[:, 2:]) / 2
        return int((np.abs(middle - (80, 60)) < (35, 25)).all(1).sum())

    sharp, blurred = (_detect(views, 0, SegmentOptions(), blur)[0] for blur in (0.0, 2.0))
    assert inside(sharp) > 10 and inside(blurred) == 0
    assert len(blurred) >= 4
