# SPDX-License-Identifier: GPL-3.0-or-later
"""Ground plan of the building, from its points seen from above.

A ray that hits the ground inside the plan has passed through a wall before, so its pixel shows the building even if
that wall has no points.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.geometry.plan_grid import PlanGrid, cells_inside
from mgf_engine.masks.image_ops import disc, fill_mask_holes
from mgf_engine.options.algorithms import parameter
from mgf_engine.scene.gravity import horizontal_axes


@dataclass(frozen=True)
class GroundPlanOptions:
    """Options of the ground plan."""

    side: int = parameter(64, "Number of cells along the longer side of the plan", low=4)
    gap: float = parameter(
        0.05, "Half width of gaps between points that are closed, as a share of the longer side of the plan", high=1
    )
    percentiles: tuple[float, float] = parameter(
        (0.5, 99.5), "Percentiles of the points that the longer side lies between", high=100
    )
    beyond: float = parameter(
        0.0625, "Distance beyond the percentiles up to which points count, as a share of the longer side of the plan"
    )
    piece: float = parameter(0.1, "Minimum area of a piece, as a share of the largest one", high=1)


@dataclass(frozen=True)
class GroundPlan:
    """Cells of the plan that the building stands on.

    Attributes:
        grid: of the plan.
        area: bool [X, Y].
    """

    grid: PlanGrid
    area: NDArray[np.bool_]

    @classmethod
    def of(
        cls, points: NDArray[np.float64], up: NDArray[np.float64], options: GroundPlanOptions = GroundPlanOptions()
    ) -> GroundPlan:
        """Draw the plan of points [N, 3] of a building, at least one, with ``up`` [3]."""
        axes = horizontal_axes(up)
        plan = points @ axes.T
        low, high = np.percentile(plan, options.percentiles, axis=0)
        longest = max(float((high - low).max()), 1e-9)
        beyond = options.beyond * longest
        near = ((plan >= low - beyond) & (plan <= high + beyond)).all(1)
        cell, reach = longest / options.side, max(1, round(options.gap * options.side))
        grid = PlanGrid(axes, plan[near].min(0) - (reach + 2) * cell, cell)
        at = grid.cells(points[near])
        spots = np.zeros(at.max(0) + reach + 3, np.uint8)
        spots[tuple(at.T)] = 1
        # What the walls enclose is filled while the gaps between their points are bridged.
        wide = fill_mask_holes(cv2.dilate(spots, disc(reach)) > 0).astype(np.uint8)
        _, piece, stats, _ = cv2.connectedComponentsWithStats(cv2.erode(wide, disc(reach)))
        large = stats[:, cv2.CC_STAT_AREA] >= options.piece * stats[1:, cv2.CC_STAT_AREA].max(initial=1)
        large[0] = False
        return cls(grid, large[piece])

    def holds(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell which points [N, 3] lie within the plan, at any height, bool [N]."""
        at = self.grid.cells(points)
        mapped = cells_inside(at, self.area.shape)
        result = np.zeros(len(points), bool)
        result[mapped] = self.area[tuple(at[mapped].T)]
        return result
