# SPDX-License-Identifier: GPL-3.0-or-later
"""Boxes leave out outliers and are padded alike on all sides."""

from __future__ import annotations

import numpy as np

from mgf_engine.geometry.boxes import pad_box, percentile_box

GRID = np.column_stack([np.linspace(0, 100, 101), np.linspace(10, 20, 101), np.full(101, 3.0)])


def test_percentiles_along_each_axis() -> None:
    low, high = percentile_box(GRID, (10, 95))
    assert np.allclose(low, [10, 11, 3]) and np.allclose(high, [95, 19.5, 3])


def test_outliers_do_not_widen_the_box() -> None:
    usual, widened = (percentile_box(p, (2, 98)) for p in (GRID, np.concatenate([GRID, [[1e9, -1e9, 1e9]]])))
    assert np.abs(np.subtract(usual, widened)).max() < 1.1  # by the next point at most


def test_padding_is_a_share_of_the_longest_side_on_all_sides() -> None:
    low, high = percentile_box(GRID, (0, 100), padding=0.1)
    assert np.allclose(low, [-10, 0, -7]) and np.allclose(high, [110, 30, 13])


def test_a_box_of_one_point_has_no_space_around_it() -> None:
    low, high = percentile_box(np.array([[1.0, 2.0]]), (3, 97), padding=0.5)
    assert low.tolist() == high.tolist() == [1, 2]


def test_the_given_corners_are_kept() -> None:
    corners = np.zeros(3), np.ones(3)
    pad_box(*corners, 1.0)
    assert corners[0].tolist() == [0, 0, 0] and corners[1].tolist() == [1, 1, 1]
