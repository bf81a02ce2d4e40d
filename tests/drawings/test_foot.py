# SPDX-License-Identifier: GPL-3.0-or-later
"""Elevations end at the ground where terrain tells that it is level; what is dug in stays."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.drawings.foot import cut_at_ground
from mgf_engine.drawings.ground import MESH, TERRAIN, GroundLevel
from mgf_engine.drawings.model import DrawingFrame
from mgf_engine.drawings.project import Grid
from mgf_engine.drawings.regions import RegionMap

SIZE, GROUND = 100, 80  # rows of the map; that of the ground
LEVEL = GroundLevel(120.0, TERRAIN, 1.0)


def wall(below: int) -> RegionMap:
    """A wall down to so many rows below the ground, pixels and rows of a ground pixel; row 80 is at a height of 120."""
    up, origin = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 100.0])
    frame = DrawingFrame("A", origin, np.array([1.0, 0.0, 0.0]), up, np.zeros(2), np.full(2, float(SIZE)))
    label = np.zeros((SIZE, SIZE), np.int32)
    label[20 : GROUND + below, 10:90] = 1
    return RegionMap(Grid(frame, 1.0, 0.0, float(SIZE), SIZE, SIZE), label, np.zeros((1, 3)))


def test_a_wall_ends_at_the_ground() -> None:
    regions = wall(7)
    line = cut_at_ground(regions, LEVEL, 1.0)
    assert regions.label[GROUND - 1].any() and not regions.label[GROUND:].any()
    assert line is not None
    np.testing.assert_allclose(line[0, :3], (0.0, 1.0, -20.0))


def test_a_wall_that_ends_above_the_ground_stays() -> None:
    regions = wall(-3)
    cut_at_ground(regions, LEVEL, 1.0)
    np.testing.assert_array_equal(regions.label, wall(-3).label)


def test_what_is_dug_in_stays() -> None:
    regions = wall(3)
    regions.label[GROUND : GROUND + 18, 40:60] = 1
    regions.label[GROUND : GROUND + 3, 10:30] = 0
    shown = regions.label.copy()
    cut_at_ground(regions, LEVEL, 0.5)
    np.testing.assert_array_equal(regions.label, shown)


@pytest.mark.parametrize("ground", [GroundLevel(120.0, MESH), GroundLevel(120.0, TERRAIN, 4.0)], ids=["no", "uneven"])
def test_a_ground_that_is_not_known_to_be_level_cuts_nothing(ground: GroundLevel) -> None:
    regions = wall(7)
    assert cut_at_ground(regions, ground, 1.0) is None
    np.testing.assert_array_equal(regions.label, wall(7).label)
