# SPDX-License-Identifier: GPL-3.0-or-later
"""The homography between two photos that the ground induces, and where it stays within the frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.analytic import camera

from mgf_engine.masks.geometry.ground_plane import GroundPlane
from mgf_engine.masks.geometry.plane_homography import homography, spans_inside

GROUND = GroundPlane(np.array([0.0, 0.0, 1.0]), 0.25, 0.01)
FIRST, SECOND = camera((3.0, -2.0, 3.0)), camera((1.0, -4.0, 2.0))


def test_a_view_is_carried_onto_itself() -> None:
    matrix = homography(FIRST, FIRST, GROUND)
    np.testing.assert_allclose(matrix / matrix[2, 2], np.eye(3), atol=1e-9)


def test_points_of_the_plane_are_carried_to_where_the_other_photo_shows_them() -> None:
    matrix = homography(FIRST, SECOND, GROUND)
    spots = np.array([[0.3, -0.4, 0.25], [-1.0, 0.7, 0.25]])
    first, second = (view.project(spots)[0] - 0.5 for view in (FIRST, SECOND))
    found = np.c_[first, np.ones(2)] @ matrix.T
    assert (found[:, 2] > 0).all()
    np.testing.assert_allclose(found[:, :2] / found[:, 2:], second, atol=1e-9)


def test_points_above_the_plane_are_not() -> None:
    spot = np.array([[0.3, -0.4, 0.75]])
    first, second = (view.project(spot)[0] - 0.5 for view in (FIRST, SECOND))
    found = np.c_[first, 1.0] @ homography(FIRST, SECOND, GROUND).T
    assert np.linalg.norm(found[:, :2] / found[:, 2:] - second) > 5


@pytest.mark.parametrize("seed", [0, 1, 2, 3, 5])
def test_what_lies_in_another_frame_is_one_span_of_each_row(seed: int) -> None:
    rng = np.random.default_rng(seed)
    matrix = np.eye(3) + rng.normal(0, (0.3, 0.3, 40), (3, 3)) * ((1, 1, 1), (1, 1, 1), (0.01, 0.01, 0.01))
    if seed == 0:
        matrix = np.array([[1.0, 0, 0], [0, 1, 30], [0, 0, 1]])  # nothing changes along a row but u
    if seed == 1:
        matrix[2, 2] = -1.0  # all but a corner lies behind the camera
    view = replace(FIRST, width=70, height=50)
    y, x = np.mgrid[:60, :90]
    u, v, w = np.einsum("ij,jhw->ihw", matrix, np.stack([x, y, np.ones_like(x)]).astype(float))
    expected = (w > 1e-9) & (u >= 0) & (v >= 0) & (u <= 69 * w) & (v <= 49 * w)
    assert 0 < expected.sum() < expected.size or seed == 1
    first, end = spans_inside(matrix, view, (90, 60)).T[:, :, None]
    np.testing.assert_array_equal((np.arange(90) >= first) & (np.arange(90) < end), expected)
