# SPDX-License-Identifier: GPL-3.0-or-later
"""Structure from motion is put onto the true frame by the cameras that are right."""

import numpy as np
import pycolmap

from mgf_engine.bench.features import _similarity


def test_one_camera_placed_wrong_does_not_move_the_model() -> None:
    rng = np.random.default_rng(0)
    true = rng.uniform(-20, 20, (24, 3))
    wanted = pycolmap.Sim3d(2.5, pycolmap.Rotation3d(np.array([0.3, -0.2, 1.1])), np.array([4.0, -1.0, 9.0]))
    found = wanted.inverse() * (true + rng.normal(scale=0.01, size=true.shape))
    found[7] += 1.0
    placed = _similarity(found, true) * found
    off = np.linalg.norm(placed - true, axis=1)
    assert off[7] > 2.0
    assert np.delete(off, 7).max() < 0.05
    # Least squares would have moved all of it by a tenth of that camera's error.
