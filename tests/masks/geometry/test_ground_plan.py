# SPDX-License-Identifier: GPL-3.0-or-later
"""The ground plan of a house whose walls have few points."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mgf_engine.masks.geometry.ground_plan import GroundPlan

UP = np.array([0.0, 0.0, 1.0])


def ring(count: int, seed: int = 0) -> np.ndarray:
    """Points on the four walls of a house of 4 x 2, 1 high, [N, 3]."""
    rng = np.random.default_rng(seed)
    side, along = rng.integers(0, 4, count), rng.uniform(-1, 1, count)
    x = np.select([side == 0, side == 1], [-2.0, 2.0], 2 * along)
    y = np.select([side == 2, side == 3], [-1.0, 1.0], along)
    return np.stack([x, y, rng.uniform(0, 1, count)], 1)


def test_the_inside_of_a_ring_of_walls_belongs_to_the_plan() -> None:
    plan = GroundPlan.of(ring(300), UP)
    inside = np.random.default_rng(1).uniform([-1.9, -0.9, -3], [1.9, 0.9, 5], (500, 3))
    assert plan.holds(inside).all()
    beside = np.array([[2.2, 0, 0], [-2.2, 0, 0], [0, 1.2, 0], [0, -1.2, 0.5], [90, 0, 0], [0, -90, 0]])
    assert not plan.holds(beside).any()


@pytest.mark.parametrize("up", [[0, 0, 1], [0.3, -0.2, 0.93], [1, 0, 0], [0, -1, 0]])
def test_the_plan_turns_with_the_frame(up: list[float]) -> None:
    direction = np.array(up, float) / np.linalg.norm(up)
    rotation = Rotation.align_vectors([direction], [UP])[0].as_matrix()
    plan = GroundPlan.of(ring(400) @ rotation.T, direction)
    probes = np.random.default_rng(2).uniform([-3, -2, -1], [3, 2, 1], (400, 3))
    truth = (np.abs(probes[:, 0]) < 2) & (np.abs(probes[:, 1]) < 1)
    assert (plan.holds(probes @ rotation.T) == truth).mean() > 0.95


def test_a_stray_point_neither_widens_the_plan_nor_coarsens_it() -> None:
    astray = np.concatenate([ring(600), [[60.0, 40.0, 0.5]]])
    plan = GroundPlan.of(astray, UP)
    assert plan.grid.cell == pytest.approx(GroundPlan.of(ring(600), UP).grid.cell, rel=0.05)
    assert not plan.holds(np.array([[60.0, 40.0, 0.5], [30.0, 20.0, 0.5]])).any()


@pytest.mark.parametrize("count", [1, 2, 5])
def test_few_points_have_a_plan_around_them(count: int) -> None:
    points = ring(count)
    assert GroundPlan.of(points, UP).holds(points).any()
    assert GroundPlan.of(np.repeat(points[:1], 4, 0), UP).holds(points[:1]).all()
