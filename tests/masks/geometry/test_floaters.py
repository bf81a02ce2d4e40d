# SPDX-License-Identifier: GPL-3.0-or-later
"""Points before the sky of photos whose lower half is a wall."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.masks.geometry.floaters import FloaterOptions, sky_behind
from mgf_engine.masks.propagation.superpixels import Superpixels
from mgf_engine.model.scene import View
from tests.support.small_scene import view

SKY, WALL, OPTIONS = 7, 0, FloaterOptions(depth=0.1)


def regions(scale: float = 1.0) -> Superpixels:
    """Superpixels of 200 x 100 px: the sky above, a wall below."""
    labels = np.repeat(np.array([0, 1], np.int32), [round(50 * scale)] * 2)
    empty = np.zeros(0, np.float32)
    return Superpixels(
        np.repeat(labels[:, None], round(200 * scale), 1), (scale, scale), np.zeros((2, 6), np.float32),
        np.array([[100, 25], [100, 75]], np.float32), np.full(2, 0.5, np.float32), np.array([1, 0], np.float32),
        np.array([[0, 1]], np.int32), empty, empty,
    )  # fmt: skip


def camera() -> View:
    """Looks along z; a point at depth 1 and (x, y) is shown at (100 + 100 x, 50 + 100 y) px."""
    return view("a.jpg", 0.0, width=200, height=100, fx=100.0, fy=100.0, cx=100.0, cy=50.0)


def behind(points: list[list[float]], scale: float = 1.0, sky: tuple[int, int] = (SKY, WALL)) -> np.ndarray:
    return sky_behind(np.array(points, float), [(camera(), regions(scale), np.array(sky))], OPTIONS)


def test_no_sky_no_points() -> None:
    assert behind([[0.0, -0.4, 1.0]], sky=(0, 0)).shape == (0, 2)
    assert sky_behind(np.zeros((3, 3)), []).shape == (0, 2)


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_points_deep_in_the_sky_are_found_with_its_piece(scale: float) -> None:
    points = [
        [0.0, -0.45, 1.0],  # deep in it
        [0.0, -0.1, 1.0],  # within 20 px of its edge, as a point on the eaves
        [0.0, 0.2, 1.0],  # on the wall
        [-1.5, -0.9, 2.0],  # in the corner: sky goes on beyond the frame
    ]
    assert behind(points, scale).tolist() == [[0, SKY], [3, SKY]]


def test_what_the_photo_does_not_show_is_not_asked() -> None:
    assert len(behind([[0.0, -0.45, -1.0], [0.0, -0.6, 1.0], [1.2, -0.45, 1.0]])) == 0


def test_each_photo_counts() -> None:
    photo = (camera(), regions(), np.array([SKY, WALL]))
    other = (camera(), regions(), np.array([SKY + 1, WALL]))
    assert sky_behind(np.array([[0.0, -0.45, 1.0]]), [photo, other], OPTIONS).tolist() == [[0, SKY], [0, SKY + 1]]
