# SPDX-License-Identifier: GPL-3.0-or-later
"""Which roof plane each cell of the ground plan gets: the one that the mesh's heights lie in, and few short steps."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.drawings.model import DrawingFrame
from mgf_engine.drawings.project import Grid
from mgf_engine.models.solid.cells import Cells, cut_into_cells
from mgf_engine.models.solid.evidence import SolidEvidence
from mgf_engine.models.solid.labels import LabelOptions, choose_planes
from mgf_engine.models.solid.plan_lines import Line2

#: A plan of 10 x 4 m in pixels of 0.1 m, cut at x = 5 into a left and a right cell.
SIZE, PIXEL = np.array([10.0, 4.0]), 0.1
CUT = Line2(np.array([1.0, 0.0]), 5.0, -9.0, 9.0, 1.0)
#: Level planes at 3 and 6 m, and one that rises from 3 m at x = 0 to 6 m at x = 10.
LOW, HIGH, RISING = [0.0, 0.0, 3.0], [0.0, 0.0, 6.0], [0.3, 0.0, 3.0]


def evidence(height: np.ndarray, inside: np.ndarray | None = None, detail: float = 0.3) -> SolidEvidence:
    frame = DrawingFrame("plan", np.zeros(3), np.eye(3)[0], np.eye(3)[1], np.zeros(2), SIZE)
    grid = Grid(frame, PIXEL, 0.0, SIZE[1], height.shape[1], height.shape[0])
    stands = np.ones(height.shape, bool) if inside is None else inside
    none = np.zeros(height.shape, np.int32)
    return SolidEvidence(grid, height, stands, none, np.zeros((0, 3)), [], 1.0, 0.0, "mesh", 6.0, 6.0, detail)


def middles() -> np.ndarray:
    """x of each pixel's middle, [40, 100]."""
    return np.tile((np.arange(100) + 0.5) * PIXEL, (40, 1))


def choose(
    height: np.ndarray, slopes: list[list[float]], inside: np.ndarray | None = None, **options: float
) -> dict[str, int]:
    """The labels of the left and the right cell."""
    cells = cut_into_cells([CUT], np.zeros(2), SIZE)
    left = _left(cells)
    owner = np.where(middles() < 5, left, 1 - left).astype(np.int32)
    label = choose_planes(cells, owner, evidence(height, inside), np.array(slopes), LabelOptions(**options))
    return {"left": int(label[left]), "right": int(label[1 - left])}


def _left(cells: Cells) -> int:
    return int(np.argmin([np.mean([cells.nodes[n][0] for n in ring]) for ring in cells.rings]))


def test_each_cell_takes_the_plane_that_its_heights_lie_in() -> None:
    height = np.where(middles() < 5, 3.0, 6.0)
    assert choose(height, [LOW, HIGH]) == {"left": 1, "right": 2}
    assert choose(height, [HIGH, LOW]) == {"left": 2, "right": 1}


def test_a_slope_beats_two_steps() -> None:
    assert choose(3 + 0.3 * middles(), [LOW, HIGH, RISING]) == {"left": 3, "right": 3}


def test_cells_that_the_building_does_not_stand_on_are_outside() -> None:
    height = np.where(middles() < 5, 3.0, np.nan)
    assert choose(height, [LOW, HIGH], inside=middles() < 5) == {"left": 1, "right": 0}


def test_a_cell_whose_heights_are_unknown_goes_with_its_neighbour() -> None:
    height = np.where(middles() < 5, 6.0, np.nan)
    assert choose(height, [LOW, HIGH]) == {"left": 2, "right": 2}


@pytest.mark.parametrize(("weight", "right"), [(0.25, 2), (40.0, 1)])
def test_a_step_is_worth_its_area(weight: float, right: int) -> None:
    """20 m² whose heights are 0.5 m off against a border of 4 m with a step of 0.5 m: detail x weight x 2 m²."""
    height = np.where(middles() < 5, 3.0, 3.5)
    found = choose(height, [LOW, [0.0, 0.0, 3.5]], step_weight=weight, length_weight=0.0)
    assert found["left"] == found["right"] if right == 1 else found == {"left": 1, "right": 2}


def test_planes_below_the_ground_or_above_all_that_was_seen_are_refused() -> None:
    height = np.full((40, 100), 6.0)
    assert choose(height, [[0.0, 0.0, -1.0], [0.0, 0.0, 6.6], HIGH]) == {"left": 3, "right": 3}
