# SPDX-License-Identifier: GPL-3.0-or-later
"""Slanted lines below eaves become level and upright; slopes of roofs and long slants stay."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from mgf_engine.drawings.model import DrawingFrame
from mgf_engine.drawings.overhangs import square_overhangs
from mgf_engine.drawings.project import Grid
from mgf_engine.drawings.regions import RegionMap
from mgf_engine.drawings.straighten import straighten

SIZE = 200


def squared(points: list[tuple[float, float]], inside: bool) -> np.ndarray:
    """The outline through points after squaring; the building is right of it, or left where ``inside`` is false."""
    up = np.array([0.0, 0.0, 1.0])
    frame = DrawingFrame("A", np.zeros(3), np.array([1.0, 0.0, 0.0]), up, np.zeros(2), np.full(2, float(SIZE)))
    grid = Grid(frame, 1.0, 0.0, float(SIZE), SIZE, SIZE)
    ends = np.array(points)
    x = np.interp(SIZE - 0.5 - np.arange(SIZE), ends[::-1, 1], ends[::-1, 0])
    covered = np.arange(SIZE)[None] + 0.5 > x[:, None]
    regions = RegionMap(grid, (covered == inside).astype(np.int32), np.zeros((1, 3)))
    dense = np.concatenate([np.linspace(a, b, 40, endpoint=False) for a, b in pairwise(ends)])
    stroke = straighten(np.concatenate([dense, ends[-1:]]), (0, 1), 1.0)
    square_overhangs(stroke, regions, 1.0)
    return stroke.points


def test_eaves_are_squared() -> None:
    found = squared([(40.0, 120.0), (48.0, 106.0), (48.0, 10.0)], True)
    np.testing.assert_allclose(found, [(40, 120), (48, 120), (48, 10)], atol=0.5)


def test_eaves_below_a_roof_that_ends_upright_are_squared() -> None:
    found = squared([(40.0, 190.0), (40.0, 120.0), (48.0, 106.0), (48.0, 10.0)], True)
    np.testing.assert_allclose(found, [(40, 190), (40, 120), (48, 120), (48, 10)], atol=0.5)


@pytest.mark.parametrize(
    "points,inside",
    [
        ([(48.0, 120.0), (40.0, 106.0), (40.0, 10.0)], True),  # a roof that ends on its wall
        ([(40.0, 120.0), (48.0, 106.0), (48.0, 10.0)], False),  # the same, on the right of its building
        ([(40.0, 150.0), (60.0, 106.0), (60.0, 10.0)], True),  # a wall that leans
    ],
)
def test_other_slants_stay(points: list[tuple[float, float]], inside: bool) -> None:
    np.testing.assert_allclose(squared(points, inside), points, atol=0.5)
