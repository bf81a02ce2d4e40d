# SPDX-License-Identifier: GPL-3.0-or-later
"""A spire stands on the building, a tree beside it does not, and neither does what lies low within its walls."""

from __future__ import annotations

import numpy as np
from support.small_scene import make_scene, view

from mgf_engine.masks.geometry.point_features import PointFeatures, measure_point_features
from mgf_engine.masks.geometry.superstructures import SuperstructureOptions, find_superstructures

UP = np.array([0.0, 0.0, 1.0])
WALLS, FEW = 2000, 40


def site() -> np.ndarray:
    """Walls of a house of 4 x 4, 3 high, then a spire on it, a tree beside it and a yard within; [P, 3]."""
    rng = np.random.default_rng(1)
    side, along, height = rng.integers(0, 4, WALLS), rng.uniform(-2, 2, WALLS), rng.uniform(0, 3, WALLS)
    edge = np.where(side % 2, 2.0, -2.0)
    walls = np.stack([np.where(side < 2, along, edge), np.where(side < 2, edge, along), height], 1)
    spire = np.stack([rng.normal(0, 0.1, FEW), rng.normal(0, 0.1, FEW), rng.uniform(3.2, 5, FEW)], 1)
    tree = spire + np.array([5.0, 0, -1])
    yard = np.stack([rng.uniform(-1, 1, FEW), rng.uniform(-1, 1, FEW), rng.uniform(0, 1, FEW)], 1)
    return np.concatenate([walls, spire, tree, yard])


def features_of(points: np.ndarray) -> PointFeatures:
    return measure_point_features(make_scene([view("a", 0)], points, [[] for _ in points]), UP)


def test_too_few_points_carry_nothing() -> None:
    points = site()
    features = features_of(points)
    assert not find_superstructures(points, np.zeros(len(points), bool), features).any()
    assert not find_superstructures(points, np.arange(len(points)) < 9, features).any()


def test_a_spire_stands_on_the_building_and_a_tree_beside_it_does_not() -> None:
    points = site()
    over = find_superstructures(points, np.arange(len(points)) < WALLS, features_of(points))
    spire, tree, yard = np.split(over[WALLS:], 3)
    assert spire.all() and not tree.any() and not yard.any()


def test_only_what_is_high_for_its_surroundings_counts() -> None:
    points = site()
    keep, features = np.arange(len(points)) < WALLS, features_of(points)
    over = find_superstructures(points, keep, features)
    assert points[over, 2].min() > 0.7 * 2.5
    assert find_superstructures(points, keep, features, SuperstructureOptions(height=0.2))[WALLS + 2 * FEW :].any()


def test_chimneys_stand_anywhere_on_the_building() -> None:
    """One at each corner, half a metre inside of the walls; and one as far outside of each."""
    walls, rng = site()[:WALLS], np.random.default_rng(2)
    corners = np.array([(x, y) for x in (-1, 1) for y in (-1, 1)])
    spots = np.concatenate([1.5 * corners, 4.5 * corners]).repeat(FEW, 0)
    chimneys = np.column_stack([spots + rng.normal(0, 0.05, spots.shape), rng.uniform(3.2, 4, len(spots))])
    points = np.concatenate([walls, chimneys])
    over = find_superstructures(points, np.arange(len(points)) < WALLS, features_of(points))
    on, beside = np.split(over[WALLS:], 2)
    assert on.all() and not beside.any()
