# SPDX-License-Identifier: GPL-3.0-or-later
"""Points of the tetrahedra: those that only shape them, and the merging of near ones."""

from __future__ import annotations

import numpy as np

from mgf_engine.start.dense import DensePoints
from mgf_engine.start.evidence import Evidence, _coarse_cells, _off_surface, _relative_strength, merge_points
from mgf_engine.start.planes import LinePlanes


def evidence(x: list[float], seen: list[list[int]], weight: list[float]) -> Evidence:
    points = np.array([[value, 0.0, 0.0] for value in x])
    views = [np.array(s, np.int64) for s in seen]
    return Evidence(points, views, np.array(weight), np.eye(len(x), 2, dtype=bool), np.ones(2))


def test_points_of_one_cube_become_the_first_with_all_views_and_the_largest_weight() -> None:
    found = merge_points(evidence([0.0, 5.0, 0.1, 0.2], [[3], [7], [1, 3], []], [1.0, 2.0, 4.0, 0.0]), 1.0)
    np.testing.assert_array_equal(found.points[:, 0], [0.0, 5.0])
    assert [s.tolist() for s in found.seen] == [[1, 3], [7]]
    np.testing.assert_array_equal(found.weight, [4.0, 2.0])
    np.testing.assert_array_equal(found.on_planes, [[True, False], [False, True]])


def test_points_apart_stay_and_may_have_no_views() -> None:
    given = evidence([0.0, 2.0, 4.0], [[], [], []], [0.0, 0.0, 0.0])
    found = merge_points(given, 1.0)
    np.testing.assert_array_equal(found.points, given.points)
    assert [s.tolist() for s in found.seen] == [[], [], []]


def test_chosen_points_keep_what_is_known_of_them() -> None:
    found = evidence([0.0, 1.0, 2.0], [[0], [1], [2]], [1.0, 2.0, 3.0]).select(np.array([2, 0]))
    assert found.points[:, 0].tolist() == [2.0, 0.0] and found.weight.tolist() == [3.0, 1.0]
    assert [s.tolist() for s in found.seen] == [[2], [0]]


def test_points_behind_the_surface_are_one_in_a_cube() -> None:
    x = np.array([0.05, 0.1, 0.6])
    points = np.stack([x, 0.1 + 0 * x, 0 * x], 1)
    dense = DensePoints(points, [np.zeros(1, np.int64)] * 3, np.ones(3), np.tile([0.0, 0, 1], (3, 1)))
    found = _off_surface(dense, 0.5)
    np.testing.assert_allclose(found, points[[0, 2]] - (0, 0, 0.5))
    assert len(_off_surface(dense, 0.0)) == 0


def test_every_second_cell_stays_where_nothing_else_is_near() -> None:
    cells = np.stack(np.meshgrid(*[np.arange(5.0)] * 3, indexing="ij"), -1).reshape(-1, 3)
    alone = _coarse_cells(cells, [np.zeros((0, 3))])
    assert len(alone) == 27 and (alone % 2 == 0).all()
    beside = _coarse_cells(cells, [np.array([[0.5, 0, 0]]), np.zeros((0, 3))])
    assert len(beside) == 25 and not (beside[:, 1:] == 0).all(1)[beside[:, 0] < 3].any()
    assert len(_coarse_cells(cells[:1], [np.zeros((0, 3))])) == 1


def test_planes_are_as_strong_as_the_strongest_on_average() -> None:
    planes = LinePlanes(np.zeros((4, 4)), [np.zeros(0, np.int64)] * 4, np.array([30.0, 10.0, 5.0, 0.0]))
    np.testing.assert_allclose(_relative_strength(planes, 2), [1.0, 0.5, 0.25, 1e-3])
    none = LinePlanes(np.zeros((0, 4)), [], np.zeros(0))
    assert len(_relative_strength(none, 2)) == 0
