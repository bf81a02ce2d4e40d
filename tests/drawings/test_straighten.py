# SPDX-License-Identifier: GPL-3.0-or-later
"""Straight segments of chains: what is kept of a polyline, where lines meet, and what is level or upright."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from mgf_engine.drawings.merge_segments import merge_segments
from mgf_engine.drawings.straighten import FittedSegment, crossing, douglas_peucker, join_ends, straighten


def segment(at: tuple[float, float], angle: float, length: float = 10.0) -> FittedSegment:
    return FittedSegment(np.array(at), np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))]), length)


def stairs(start: float, end: float, slope: float) -> np.ndarray:
    """A line as pixels show it: corners of whole numbers."""
    x = np.arange(start, end + 1)
    return np.repeat(np.stack([x, np.floor(slope * x)], 1), 2, axis=0)[1:-1]


def test_split_keeps_the_corner_alone() -> None:
    points = np.array([[0, 0], [1, 0.1], [2, -0.1], [3, 0], [3.1, 1], [2.9, 2], [3, 3.0]])
    assert douglas_peucker(points, 0.5) == [0, 3, 6]
    assert douglas_peucker(points, 5.0) == [0, 6]
    assert douglas_peucker(points[:2], 0.1) == [0, 1]


def test_lines_meet_where_they_cross_and_near_parallel_ones_between() -> None:
    place = np.array([5.0, 5.0])
    np.testing.assert_allclose(
        crossing([segment((0, 5.0), 0), segment((5.2, 0), 90)], place, 1.0), [5.2, 5.0], atol=1e-6
    )
    np.testing.assert_allclose(
        crossing([segment((0, 5.0), 0), segment((0, 5.4), 2)], place, 1.0), [5.0, 5.3], atol=0.05
    )
    # They cross 30 away: the level one stays.
    far = crossing([segment((0, 5.0), 0), segment((0, 30.0), 40)], place, 1.0)
    np.testing.assert_allclose(far, place, atol=0.3)


@pytest.mark.parametrize("slope", [0.0, 0.02])
def test_a_level_line_of_pixels_becomes_level(slope: float) -> None:
    stroke = straighten(stairs(0, 60, slope), (0, 1), 1.0)
    assert len(stroke.segments) == 1 and stroke.segments[0].level and not stroke.segments[0].upright


def test_a_sloping_line_keeps_its_slope() -> None:
    stroke = straighten(stairs(0, 60, 0.5), (0, 1), 1.0)
    assert len(stroke.segments) == 1 and not stroke.segments[0].level
    along = stroke.segments[0].along
    assert along[1] / along[0] == pytest.approx(0.5, abs=0.02)


def test_a_short_part_gives_way_to_longer_neighbours_only() -> None:
    """A slope between a level and an upright part, which is shorter than it or longer."""

    def straightened(height: float) -> np.ndarray:
        ends = np.array([[0, 0], [30, 0], [35, 5], [35, 5 + height], [65, 5 + height]], float)
        steps = [np.linspace(a, b, 6, endpoint=False) for a, b in pairwise(ends)]
        return straighten(np.concatenate([*steps, ends[-1:]]), (0, 1), 1.0).points

    np.testing.assert_allclose(straightened(5), [[0, 0], [30, 0], [35, 5], [35, 10], [65, 10]], atol=1e-9)
    np.testing.assert_allclose(straightened(25), [[0, 0], [35, 0], [35, 30], [65, 30]], atol=1e-9)


def test_a_rectangle_has_four_runs_and_exact_corners() -> None:
    corners = np.array([[0, 0], [40, 0.4], [40, 20], [0.3, 20], [0, 0]])
    stroke = straighten(corners, (3, 3), 1.0)
    assert stroke.closed and len(stroke.segments) == 4
    assert (
        sum(segment.level for segment in stroke.segments) == 2
        and sum(segment.upright for segment in stroke.segments) == 2
    )
    assert (stroke.points[0] == stroke.points[-1]).all()


def test_strokes_that_end_in_one_place_meet_in_one_point() -> None:
    level = straighten(np.array([[0, 0.2], [30.0, 0.2]]), (0, 1), 1.0)
    upright = straighten(np.array([[30.3, 0.0], [30.3, -25.0]]), (1, 2), 1.0)
    join_ends([level, upright], {1: np.array([30.0, 0.0])}, 1.0)
    np.testing.assert_allclose(level.points[-1], upright.points[0])
    np.testing.assert_allclose(level.points[-1], [30.3, 0.2], atol=1e-6)


def test_segments_on_one_line_become_one_and_others_stay() -> None:
    def segment(*numbers: float) -> tuple[np.ndarray, np.ndarray]:
        return np.array(numbers[:2]), np.array(numbers[2:])

    found = merge_segments([segment(0, 0, 10, 0), segment(9, 0.1, 20, 0.1), segment(0, 5, 10, 5)], 1.0)
    spans = sorted(round(float(np.hypot(*(b - a)))) for a, b in found)
    assert spans == [10, 20]


@pytest.mark.parametrize("apart,points", [(1.0, 1), (5.0, 2)])
def test_the_edge_of_a_roof_and_the_wall_below_keep_their_own_lines(apart: float, points: int) -> None:
    roof = straighten(np.array([[0.0, 60.0], [0.0, 30.0]]), (5, 9), 1.0)
    wall = straighten(np.array([[apart, 30.0], [apart, 0.0]]), (9, 6), 1.0)
    eaves = straighten(np.array([[0.0, 30.0], [60.0, 30.0]]), (9, 7), 1.0)
    join_ends([roof, wall, eaves], {9: np.array([0.0, 30.0])}, 1.0)
    ends = roof.points[-1], wall.points[0], eaves.points[0]
    assert len({tuple(np.round(end, 6)) for end in ends}) == points
    if points == 2:
        np.testing.assert_allclose(ends, [(0, 30), (5, 30), (0, 30)], atol=1e-6)


def test_a_chimney_reaches_the_ridge_on_both_sides() -> None:
    """Its foot is drawn two pixels above the ridge; the chain goes up, across and down."""
    chimney = straighten(np.array([[20.0, 30.0], [20.0, 60.0], [40.0, 60.0], [40.0, 30.0]]), (1, 2), 1.0)
    foot = straighten(np.array([[20.0, 32.0], [40.0, 32.0]]), (1, 2), 1.0)
    left = straighten(np.array([[0.0, 30.0], [20.0, 30.0]]), (3, 1), 1.0)
    right = straighten(np.array([[40.0, 30.0], [90.0, 30.0]]), (2, 4), 1.0)
    join_ends([chimney, foot, left, right], {1: np.array([20.0, 31.0]), 2: np.array([40.0, 31.0])}, 1.0)
    np.testing.assert_allclose(chimney.points[[0, -1]], [(20, 30), (40, 30)], atol=1e-6)
    np.testing.assert_allclose(foot.points, [(20, 32), (40, 32)], atol=1e-6)
