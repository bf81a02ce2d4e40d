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
    ends, sides = _detect(views, 0, SegmentOptions())
    assert ends.shape == (0, 4) and sides.shape == (0, 2, 3)
    labels[20:60, 70:110] = BACKGROUND + 1
    ends, sides = _detect(views, 0, SegmentOptions())
    assert len(ends) >= 4 and len(sides) == len(ends) and (sides[:, 0, 0] >= sides[:, 1, 0]).all()
