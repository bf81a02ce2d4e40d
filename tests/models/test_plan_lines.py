# SPDX-License-Identifier: GPL-3.0-or-later
"""Lines of a ground plan: how far apart two are, which are one, and what walls a box has."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.models.solid.plan_lines import Line2, distance_between, merge_lines


def line(angle: float, offset: float, low: float = 0.0, high: float = 10.0, weight: float = 1.0) -> Line2:
    """A line whose normal has an angle in degrees; its extent runs counter-clockwise of the normal."""
    normal = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
    return Line2(normal, offset, low, high, weight)


def test_distance_of_parallel_lines_beside_each_other() -> None:
    assert distance_between(line(0, 2.0), line(0, 2.5)) == pytest.approx(0.5)
    assert distance_between(line(180, -2.0, -10, 0), line(0, 2.5)) == pytest.approx(0.5)  # the same from behind
    assert distance_between(line(0, 2.0), line(90, 2.0)) == np.inf
    assert distance_between(line(0, 2.0), line(0, 2.0, 100.0, 110.0)) == np.inf  # far along it


def test_near_lines_become_one_where_the_heavier_lies() -> None:
    (merged,) = merge_lines([line(0, 2.0, 0, 4, weight=3.0), line(0, 2.4, 3, 10, weight=1.0)], detail=0.5)
    assert (merged.low, merged.high, merged.weight) == (0, 10, 4.0)
    assert merged.offset == pytest.approx(2.1)


def test_lines_a_detail_apart_stay_two_heavier_first() -> None:
    found = merge_lines([line(0, 2.0, weight=1.0), line(0, 3.0, weight=5.0), line(90, 2.0, weight=2.0)], detail=0.5)
    assert [each.weight for each in found] == [5.0, 2.0, 1.0]
