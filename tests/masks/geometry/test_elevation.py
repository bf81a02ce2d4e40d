# SPDX-License-Identifier: GPL-3.0-or-later
"""Elevation of the rays of pixels over the horizon, of cameras whose tilt is known."""

from __future__ import annotations

import numpy as np
import pytest
from support.analytic import camera

from mgf_engine.masks.geometry.elevation import elevation, over_horizon

UP = np.array([0.0, 0.0, 1.0])


@pytest.mark.parametrize("tilt", [-20.0, 0.0, 35.0])
def test_elevation_of_the_middle_column_is_the_tilt_and_the_angle_from_the_axis(tilt: float) -> None:
    view = camera((0.0, -4.0, 1.0), target=(0.0, -3.0, 1.0 + np.tan(np.radians(tilt))), width=161)
    rows = np.arange(view.height) + 0.5
    wanted = tilt - np.degrees(np.arctan((rows - view.cy) / view.fy))
    np.testing.assert_allclose(elevation(view, UP)[:, 80], wanted, atol=1e-9)


def test_rays_beside_the_middle_rise_less() -> None:
    view = camera((0.0, -4.0, 1.0), target=(0.0, -3.0, 1.0))
    x, y = view.pixel_rays()
    np.testing.assert_allclose(elevation(view, UP)[3], np.degrees(np.arctan(-y[3] / np.hypot(1, x))), atol=1e-9)


@pytest.mark.parametrize("degrees", [-3.0, 0.0, 1.5, 10.0])
def test_over_the_horizon_are_rays_of_a_larger_elevation(degrees: float) -> None:
    view = camera((1.0, -4.0, 2.0))
    np.testing.assert_array_equal(over_horizon(view, UP, degrees), elevation(view, UP) > degrees)


def test_straight_up_and_down_are_90_degrees() -> None:
    view = camera((0.0, 0.0, 1.0), target=(0.0, 1e-9, 5.0), width=161, height=129)
    assert elevation(view, UP)[64, 80] == pytest.approx(90.0, abs=1e-6)
    assert elevation(view, -UP)[64, 80] == pytest.approx(-90.0, abs=1e-6)
