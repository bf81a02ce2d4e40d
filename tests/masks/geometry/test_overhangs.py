# SPDX-License-Identifier: GPL-3.0-or-later
"""A house of 4 x 2 m, 2 m high, under a roof that stands out by 0.3 m: only its rim overhangs."""

from __future__ import annotations

import numpy as np

from mgf_engine.masks.geometry.overhangs import Overhangs

UP, SPACING = np.array([0.0, 0.0, 1.0]), 0.1


def plate(x: float, y: float, z: float) -> np.ndarray:
    """Points of a level rectangle of 2x by 2y, a spacing apart, [N, 3]."""
    grid = np.meshgrid(np.arange(-x, x + 1e-9, SPACING), np.arange(-y, y + 1e-9, SPACING), [z], indexing="ij")
    return np.stack(grid, -1).reshape(-1, 3)


def walls() -> np.ndarray:
    levels = np.concatenate([plate(2, 1, z) for z in np.arange(0, 2, SPACING)])
    return levels[(np.abs(levels[:, 0]) > 1.95) | (np.abs(levels[:, 1]) > 0.95)]


HOUSE = np.concatenate([walls(), plate(2.3, 1.3, 2.0)])
PROBES = np.array([[0, 0, 2], [1.95, 0, 2], [0, 0.95, 2], [2.25, 0, 2], [0, -1.25, 2], [2.25, 1.2, 2]])


def test_eaves_overhang_and_the_roof_over_the_walls_does_not() -> None:
    assert Overhangs(HOUSE, UP, SPACING)(PROBES).tolist() == [0, 0, 0, 1, 1, 1]


def test_the_answer_turns_with_the_frame() -> None:
    turn = np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])
    assert Overhangs(HOUSE @ turn.T, turn @ UP, SPACING)(PROBES @ turn.T).tolist() == [0, 0, 0, 1, 1, 1]


def test_a_roof_far_from_any_wall_reaches_the_ground() -> None:
    annexe = plate(0.5, 0.5, 2.0) + np.array([5.0, 0, 0])
    over = Overhangs(np.concatenate([HOUSE, annexe]), UP, SPACING)
    assert over(np.array([[5.0, 0, 2], [2.25, 0, 2]])).tolist() == [0, 1]


def test_photos_from_straight_above_tell_of_no_overhang() -> None:
    assert not Overhangs(HOUSE, UP, SPACING, walls_seen=False)(PROBES).any()


def test_under_photos_straight_down_roofs_reach_the_ground() -> None:
    x, y = np.meshgrid(np.arange(0, 20.0), np.arange(0, 20.0))
    roof = np.stack([x.ravel(), y.ravel(), np.full(x.size, 12.0)], 1)
    z = np.arange(0, 12.0)
    walls = np.concatenate([[[a, b, c] for c in z] for a in range(3, 17) for b in (3, 16)] +
                           [[[a, b, c] for c in z] for b in range(3, 17) for a in (3, 16)])  # fmt: skip
    eave = np.array([[1.2, 10.0, 5.0]])
    points, up = np.concatenate([roof, walls.astype(float)]), np.array([0.0, 0, 1])
    assert Overhangs(points, up, 1.0)(eave).all()
    assert not Overhangs(points, up, 1.0, walls_seen=False)(eave).any()
