# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras project and unproject by the pinhole model."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from mgf_engine.model.scene import View


def camera() -> View:
    """fx 100, fy 50, principal point (20, 10), at (1, 2, 3), looking along the world's x with its z up."""
    rotation = np.array([[0, -1.0, 0], [0, 0, -1.0], [1.0, 0, 0]])
    return View("a", "", 40, 20, 100, 50, 20, 10, rotation, -rotation @ [1.0, 2.0, 3.0], 40, 20)


def test_a_pixel_shows_the_point_at_its_depth() -> None:
    """10 px right of the principal point at depth 5: 0.5 to the right; 10 px below it: 1 down."""
    found = camera().unproject(np.array([[20.0, 10.0], [30.0, 20.0]]), np.array([4.0, 5.0]))
    assert np.allclose(found, [[5, 2, 3], [6, 1.5, 2]], atol=1e-12)


def test_unprojecting_undoes_projecting() -> None:
    random = np.random.default_rng(0)
    rotation = Rotation.random(rng=random).as_matrix()
    view = View("a", "", 40, 20, 100, 50, 20, 10, rotation, random.normal(size=3), 40, 20)
    uv, depth = random.uniform(0, 20, (50, 2)), random.uniform(1, 9, 50)
    again = view.project(view.unproject(uv, depth))
    assert np.allclose(again[0], uv, atol=1e-9) and np.allclose(again[1], depth, atol=1e-12)
