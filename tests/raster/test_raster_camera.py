# SPDX-License-Identifier: GPL-3.0-or-later
"""The rasterizer's camera agrees with the scene's view at every size."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.model.scene import View
from mgf_engine.raster.api import Camera


def view() -> View:
    rotation = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    return View("a.jpg", "a.png", 101, 67, 90.0, 91.0, 50.0, 34.0, rotation, np.array([0.1, -0.2, 5.0]), 1010, 670)


@pytest.mark.parametrize("factor", [1.0, 0.5, 0.25, 0.3, 0.001])
def test_points_keep_their_place_in_the_picture(factor: float) -> None:
    full, reduced = view(), Camera.from_view(view(), factor)
    assert (reduced.width, reduced.height) == (max(1, round(101 * factor)), max(1, round(67 * factor)))
    points = np.random.default_rng(1).normal(size=(20, 3))
    local = points @ reduced.rotation.T + reduced.translation
    uv = local[:, :2] / local[:, 2:] * (reduced.fx, reduced.fy) + (reduced.cx, reduced.cy)
    expected, depth = full.project(points)
    assert np.allclose(uv / (reduced.width, reduced.height), expected / (101, 67))
    assert np.allclose(local[:, 2], depth)


def test_centre_and_tiles() -> None:
    camera = Camera.from_view(view())
    assert np.allclose(camera.rotation @ camera.centre + camera.translation, 0)
    assert camera.tiles == (5, 7)
    packed = camera.packed()
    assert packed.shape == (32,) and packed[21:23].tolist() == [101.0, 67.0]
