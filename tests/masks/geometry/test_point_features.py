# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

import numpy as np

from mgf_engine.masks.geometry.overhangs import Overhangs


def test_under_photos_straight_down_roofs_reach_the_ground() -> None:
    x, y = np.meshgrid(np.arange(0, 20.0), np.arange(0, 20.0))
    roof = np.stack([x.ravel(), y.ravel(), np.full(x.size, 12.0)], 1)
    z = np.arange(0, 12.0)
    walls = np.concatenate([[[a, b, c] for c in z] for a in range(3, 17) for b in (3, 16)] +
                           [[[a, b, c] for c in z] for b in range(3, 17) for a in (3, 16)])  # fmt: skip
    eave = np.array([[1.2, 10.0, 5.0]])
    points, up = np.concatenate([roof, walls.astype(float)]), np.array([0.0, 0, 1])
    assert Overhangs(points, up, 1.0)(eave).all()
    assert not Overhangs(points, up, 1.0, walls_seen=False)(eave).any()
