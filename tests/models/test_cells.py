# SPDX-License-Identifier: GPL-3.0-or-later
"""A ground plan of 4 x 2 cut along lines: cells that share corners and cover it without overlap."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from mgf_engine.models.solid.cells import OUTSIDE, Cells, cut_into_cells
from mgf_engine.models.solid.plan_lines import Line2

LOW, HIGH = np.array([0.0, 0.0]), np.array([4.0, 2.0])


def line(x: float, y: float, offset: float) -> Line2:
    normal = np.array([x, y]) / np.hypot(x, y)
    return Line2(normal, offset, -9.0, 9.0, 1.0)


def areas(cells: Cells) -> list[float]:
    return sorted(round(shapely.Polygon([cells.nodes[n] for n in ring]).area, 6) for ring in cells.rings)


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        ([], [8.0]),
        ([line(1, 0, 1)], [2.0, 6.0]),
        ([line(1, 0, 1), line(0, 1, 0.5)], [0.5, 1.5, 1.5, 4.5]),
        ([line(1, 0, 9)], [8.0]),  # beside the plan
        ([line(1, -1, 0)], [2.0, 6.0]),  # y = x, from corner to edge
    ],
)
def test_cells_cover_the_plan(lines: list[Line2], expected: list[float]) -> None:
    cells = cut_into_cells(lines, LOW, HIGH)
    assert areas(cells) == pytest.approx(expected)
    assert all(shapely.Polygon([cells.nodes[n] for n in ring]).exterior.is_ccw for ring in cells.rings)


def test_each_edge_is_listed_once_with_the_cells_at_both_sides() -> None:
    cells = cut_into_cells([line(1, 0, 1)], LOW, HIGH)
    borders = cells.borders()
    inner = [(u, v) for u, v, left, right in borders if OUTSIDE not in (left, right)]
    assert len(borders) == 7 and len(inner) == 1  # three outer edges of each cell, and the one between them
    assert {cells.nodes[n] for n in inner[0]} == {(1.0, 0.0), (1.0, 2.0)}
    assert all(cells.sides[u, v] == left for u, v, left, _ in borders)


def test_a_corner_on_an_edge_belongs_to_the_cells_at_both_sides() -> None:
    cells = cut_into_cells([line(1, 0, 1)], LOW, HIGH)
    u, v = next((u, v) for u, v, left, right in cells.borders() if OUTSIDE not in (left, right))
    cells.divide(u, v, (1.0, 0.7))
    new = len(cells.nodes) - 1
    assert [len(ring) for ring in cells.rings] == [5, 5] and all(new in ring for ring in cells.rings)
    assert areas(cells) == pytest.approx([2.0, 6.0]) and len(cells.borders()) == 8
