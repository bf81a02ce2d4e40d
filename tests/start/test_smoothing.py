# SPDX-License-Identifier: GPL-3.0-or-later
"""Stereo points moved onto planes through their neighbours: noise goes, steps stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from mgf_engine.native import library
from mgf_engine.start import reference
from mgf_engine.start.options import PointSmoothingOptions
from mgf_engine.start.smoothing import smooth_points

PIXEL = 0.01
OPTIONS = PointSmoothingOptions()


def wall(step: float = 0.0, noise: float = 1.0, seed: int = 0) -> np.ndarray:
    """Points 3 px apart on the plane y = 0, deeper by ``step`` px where x > 0, with noise across the plane."""
    x, z = (3 * PIXEL * grid.ravel() for grid in np.mgrid[-30:30, -30:30] + 0.5)
    y = step * PIXEL * (x > 0) + np.random.default_rng(seed).normal(0, noise * PIXEL, x.shape)
    return np.stack([x, y, z], 1)


@pytest.fixture(params=library.runnable_variants())
def variant(request: pytest.FixtureRequest):
    library.use_variant(request.param)
    yield
    library.use_variant("")


def test_noise_across_a_wall_becomes_a_half_and_normals_are_the_walls() -> None:
    rough = wall()
    points, normals = smooth_points(rough, 0 * rough, PIXEL, OPTIONS)
    assert points[:, 1].std() < rough[:, 1].std() / 2
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
    assert np.degrees(np.arccos(np.abs(normals[:, 1]).clip(0, 1))).max() < 25


def test_a_step_stays_where_it_is() -> None:
    points, _ = smooth_points(wall(step=10, noise=0.3), 0 * wall(), PIXEL, OPTIONS)
    for side, depth in ((points[:, 0] < 0, 0.0), (points[:, 0] > 0, 10.0)):
        assert np.abs(points[side, 1] / PIXEL - depth).max() < 2.5


def test_no_rounds_leave_points_as_they_are() -> None:
    given = np.tile([0.0, 1.0, 0.0], (len(wall()), 1))
    points, normals = smooth_points(wall(), given, PIXEL, replace(OPTIONS, rounds=0))
    np.testing.assert_array_equal(points, wall())
    np.testing.assert_array_equal(normals, given)


@pytest.mark.parametrize("count", [0, 1, 2, 5])
def test_few_points(count: int) -> None:
    points, normals = smooth_points(wall()[:count], wall()[:count], PIXEL, OPTIONS)
    assert points.shape == normals.shape == (count, 3)
    assert np.isfinite(points).all()
    assert np.isfinite(normals).all()


def test_no_point_moves_further_than_it_may() -> None:
    rough = wall(noise=5)
    points, _ = smooth_points(rough, 0 * rough, PIXEL, replace(OPTIONS, rounds=1, most=0.5))
    assert np.linalg.norm(points - rough, axis=1).max() <= 0.5 * PIXEL * (1 + 1e-6)


def test_kernel_and_reference_agree(variant: None) -> None:
    rough = np.concatenate([wall(step=4), np.random.default_rng(1).uniform(-1, 1, (200, 3))])
    points, normals = smooth_points(rough, 0 * rough, PIXEL, replace(OPTIONS, rounds=1))
    near = cKDTree(rough).query(rough, OPTIONS.neighbours)[1]
    sizes = (np.float64(np.float32(v * PIXEL)) for v in (OPTIONS.radius, OPTIONS.offset, OPTIONS.most))
    radius, offset, most = sizes
    for row in range(0, len(rough), 37):
        point, normal = reference.smooth_point(rough, row, near[row], radius, offset, most)
        np.testing.assert_allclose(points[row], point, atol=1e-7)
        assert abs(normals[row] @ normal) == pytest.approx(1, abs=1e-9)
