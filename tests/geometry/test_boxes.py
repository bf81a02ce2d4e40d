# SPDX-License-Identifier: GPL-3.0-or-later
"""Boxes leave out outliers and are padded alike on all sides; their overlap is that of rectangles by hand."""

from __future__ import annotations

import numpy as np

from mgf_engine.geometry.boxes import intersection_areas, intersection_over_union, pad_box, percentile_box

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


def test_overlap_of_rectangles() -> None:
    square = np.array([[0.0, 0, 2, 2]])
    others = np.array([[0.0, 0, 2, 2], [1, 1, 3, 3], [2, 0, 4, 2], [5, 5, 6, 9]])  # same, corner, touching, apart
    assert intersection_areas(square, others).tolist() == [[4, 1, 0, 0]]
    assert intersection_over_union(square, others).tolist() == [[1, 1 / 7, 0, 0]]
    assert intersection_over_union(square, np.zeros((0, 4))).shape == (1, 0)
