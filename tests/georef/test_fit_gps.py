# SPDX-License-Identifier: GPL-3.0-or-later
"""The similarity that aligns cameras to the places their photos were taken at, and when there is none."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mgf_engine.georef.fit_gps import MIN_GPS_POSITIONS, GpsFit, fit_gps
from mgf_engine.georef.gps import GpsPosition
from mgf_engine.georef.similarity import Direction, matrix_of, transform_points

TRUE = matrix_of(4.0, Rotation.from_rotvec([0, 0, -0.7]).as_matrix(), np.array([30.0, -8.0, 200.0]))
UP = Direction(np.array([0.0, 0.0, 1.0]), 0.02)
ANGLES = np.linspace(0, 2 * np.pi, 12, endpoint=False)
RING = np.stack([5 * np.cos(ANGLES), 5 * np.sin(ANGLES), 0.3 * np.sin(3 * ANGLES)], 1)


def fit(
    centres: np.ndarray = RING,
    errors: np.ndarray | float = 0.0,
    sd: tuple[float, float] = (3.0, 6.0),
    up: Direction = UP,
) -> GpsFit | str:
    places = [GpsPosition(0.0, 0.0, 0.0, sd)] * len(centres)
    return fit_gps(centres, transform_points(TRUE, centres) + errors, places, up)


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"centres": RING[: MIN_GPS_POSITIONS - 1]}, "only 3 photos have one"),
        ({"sd": (3.0, 1e4)}, "they have no heights"),
        ({"centres": np.outer(np.arange(8.0), [1.0, 2.0, 0.0])}, "they lie on a line"),
        ({"errors": np.random.default_rng(0).normal(0, 300, (12, 3))}, "they contradict the cameras"),
        ({"up": Direction(np.array([0.0, 0.0, -1.0]), 10.0)}, "the building would stand on its head"),
    ],
)
def test_places_that_tell_nothing_say_why(given: dict, why: str) -> None:
    assert fit(**given) == why


def test_places_in_a_narrow_strip_tell_nothing_where_they_are_far_off() -> None:
    """A strip of 30 x 1.2 m with errors of 6 m along it: across it the errors decide, not the cameras."""
    strip = np.array([[0.0, 0.15, 0], [1.9, -0.15, 0.1], [3.7, 0.15, 0], [5.6, -0.15, 0.1], [7.5, 0.15, 0]])
    along = TRUE[:3, 0] / np.linalg.norm(TRUE[:3, 0])
    errors = np.outer([6.0, -7.0, 0.0, 7.0, -6.0], along)
    assert str(fit(strip, errors)).startswith("they lie too near to each other")
    assert isinstance(fit(strip), GpsFit)


def test_exact_places_give_the_similarity() -> None:
    found = fit()
    assert isinstance(found, GpsFit) and found.used.all()
    np.testing.assert_allclose(found.matrix, TRUE, atol=1e-6)
    assert np.abs(found.residuals).max() < 1e-6 and (found.rms < 1e-6).all()


def test_a_place_far_off_is_left_out_and_its_residual_told() -> None:
    errors = np.zeros((12, 3))
    errors[4] = (60.0, 0.0, 0.0)
    found = fit(errors=errors)
    assert isinstance(found, GpsFit) and np.flatnonzero(~found.used).tolist() == [4]
    np.testing.assert_allclose(found.matrix, TRUE, atol=1e-6)
    np.testing.assert_allclose(found.residuals[4], (-60.0, 0.0, 0.0), atol=1e-5)
    assert (found.rms < 1e-5).all()


def test_accuracies_that_are_too_good_are_widened() -> None:
    """Errors of four times what the photos state: with their own accuracy most would be outliers."""
    errors = np.random.default_rng(2).normal(0, 0.4, (12, 3))
    found = fit(errors=errors, sd=(0.1, 0.1))
    assert isinstance(found, GpsFit) and found.used.sum() >= 8
    assert 0.1 < found.rms.mean() < 0.8
