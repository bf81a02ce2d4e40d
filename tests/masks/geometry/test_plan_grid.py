# SPDX-License-Identifier: GPL-3.0-or-later
"""Points fall into the cells of the ground plan that they lie over."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.masks.geometry.plan_grid import PlanGrid, cells_inside
from mgf_engine.scene.gravity import horizontal_axes

GRID = PlanGrid(np.eye(3)[:2], np.array([10.0, 20.0]), 0.5)


def test_a_cell_holds_its_lower_edge_and_not_its_upper_one() -> None:
    points = np.array([[10, 20, 7], [10.49, 20.5, -7], [10.5, 21.49, 0], [9.99, 20, 0]], float)
    assert GRID.cells(points).tolist() == [[0, 0], [0, 1], [1, 2], [-1, 0]]


def test_what_lies_beyond_all_measure_is_far_outside() -> None:
    (cell,) = GRID.cells(np.array([[1e300, -1e300, 0]]))
    assert cell[0] > 1e9 and cell[1] < -1e9


def test_inside_is_the_shape_of_the_map() -> None:
    assert cells_inside(np.array([[0, 0], [1, 2], [2, 2], [1, 3], [-1, 0]]), (2, 3)).tolist() == [1, 1, 0, 0, 0]


@pytest.mark.parametrize("up", [[0, 0, 1], [0, -1, 0], [0.6, 0, 0.8], [1, 0, 0]])
def test_horizontal_axes_are_perpendicular_to_up_and_to_each_other(up: list[float]) -> None:
    frame = np.vstack([horizontal_axes(np.array(up, float)), up])
    assert np.allclose(frame @ frame.T, np.eye(3), atol=1e-12)
