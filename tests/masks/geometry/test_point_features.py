# SPDX-License-Identifier: GPL-3.0-or-later
"""Local shape around sparse points: spacing, normals, flatness, and which points neighbours support."""

from __future__ import annotations

import numpy as np
import pytest
from support.small_scene import make_scene, view

from mgf_engine.masks.geometry.point_features import PointFeatures, measure_point_features

UP = np.array([0.0, 0.0, 1.0])


def features_of(points: np.ndarray) -> PointFeatures:
    return measure_point_features(make_scene([view("a", 0)], points, [[] for _ in points]), UP)


@pytest.mark.parametrize("count", [0, 1])
def test_a_point_alone_has_no_neighbours(count: int) -> None:
    features = features_of(np.zeros((count, 3)))
    assert len(features.pairs) == 0 and features.spacing.tolist() == [1.0] * count and not features.astray.any()


def test_a_grid_has_its_spacing_and_its_normal_and_is_flat() -> None:
    x, y = np.meshgrid(np.arange(12.0), np.arange(12.0))
    features = features_of(np.stack([0.5 * x.ravel(), 0.5 * y.ravel(), np.full(x.size, 3.0)], 1))
    inner = (np.minimum(x, y).ravel() > 1) & (np.maximum(x, y).ravel() < 10)
    assert features.spacing[inner] == pytest.approx(0.5 * np.sqrt(2), abs=0.21)  # 4 at 0.5, 4 at 0.71, 2 at 1
    assert np.abs(features.normals[inner] @ UP) == pytest.approx(1.0) and features.flatness[inner] == pytest.approx(1.0)
    assert features.height == pytest.approx(0.0)


def test_kept_points_are_supported_by_kept_neighbours() -> None:
    """A row of points one apart, of which the left half is kept and one far in the other half as well."""
    points = np.stack([np.arange(40.0), np.zeros(40), np.zeros(40)], 1)
    features = features_of(points)
    keep = np.arange(40) < 20
    keep[30] = True
    found = features.supported(keep)
    assert found[:15].all() and not found[20:].any()  # none that is not kept, and not the lonely one
    assert not features.supported(np.zeros(40, bool)).any()
