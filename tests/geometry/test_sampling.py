# SPDX-License-Identifier: GPL-3.0-or-later
import numpy as np
import pytest

from mgf_engine.geometry.sampling import farthest_point_sampling

LINE = np.array([[0.0], [1.0], [2.0], [10.0], [9.0]])


def test_each_choice_is_the_farthest_from_those_before() -> None:
    assert farthest_point_sampling(LINE, 5, [0]) == [0, 3, 2, 1, 4]  # 10; then 2, at 2 from 0; then 1 and 9, at 1 each


def test_given_points_come_first_and_count() -> None:
    assert farthest_point_sampling(LINE, 3, [3, 4]) == [3, 4, 0]
    assert farthest_point_sampling(LINE, 1, [3, 4]) == [3, 4]


@pytest.mark.parametrize("count", [1, 3, 99])
def test_points_in_one_place_are_chosen_once_each(count: int) -> None:
    assert farthest_point_sampling(np.zeros((4, 2)), count, [2]) == [2, 0, 1, 3][: min(count, 4)]
