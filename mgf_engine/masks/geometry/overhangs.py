# SPDX-License-Identifier: GPL-3.0-or-later
"""Find overhangs, below which there is no wall: eaves, cornices and stray points."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.geometry.plan_grid import PlanGrid
from mgf_engine.masks.image_ops import disc, fill_mask_holes
from mgf_engine.options.algorithms import parameter
from mgf_engine.scene.gravity import horizontal_axes

Map = NDArray[np.bool_]
Points = NDArray[np.float64]


@dataclass(frozen=True)
class OverhangOptions:
    """Options of overhangs."""

    wall: float = parameter(4.0, "Height over which points stand above each other in a wall", "point spacings")
    gap_in_walls: float = parameter(0.12, "Half the largest gap in a wall, as a share of the plan's size", high=1)
    reach: float = parameter(5.0, "Distance beyond the walls within which something overhangs", "point spacings")
    largest_plan: int = parameter(1000, "Maximum number of cells along a side of the ground plan", low=10)


class Overhangs:
    """What is just outside the walls and held up by nothing from below: eaves, cornices and stray points.

    Walls are where points stand above each other; between them, and inside, everything reaches the ground. So does what
    is far from any wall: a part of the building of which photos show the roof alone.

    Args:
        points: [P, 3], of the building; up: [3]; spacing: of the points, side of the cells of the ground plan.
        walls_seen: photos straight down show walls at a slant, with hardly a point on them: there nothing overhangs.
    """

    def __init__(
        self,
        points: Points,
        up: Points,
        spacing: float,
        walls_seen: bool = True,
        options: OverhangOptions = OverhangOptions(),
    ) -> None:
        axes = horizontal_axes(up)
        plan, height = points @ axes.T, (points @ up).astype(np.float32)
        border = round(options.reach) + 1
        self._grid = PlanGrid(axes, plan.min(0) - border * spacing, spacing)
        size = np.ceil((plan.max(0) - self._grid.low) / spacing).astype(int) + border
        size = np.minimum(size, options.largest_plan)
        top, bottom = np.full(size, -np.inf, np.float32), np.full(size, np.inf, np.float32)
        at = self._cells(points, top)
        np.maximum.at(top, at, height)
        np.minimum.at(bottom, at, height)
        around = np.ones((3, 3), np.uint8)
        with np.errstate(over="ignore", invalid="ignore"):  # no point around: minus infinity less infinity
            walls = (cv2.dilate(top, around) - cv2.erode(bottom, around) > options.wall * spacing).astype(np.uint8)
        reach = max(1, round(options.gap_in_walls * max(size)))
        padded = cv2.copyMakeBorder(walls, reach, reach, reach, reach, cv2.BORDER_CONSTANT)
        closed = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, disc(reach))[reach:-reach, reach:-reach]
        inside = cv2.erode(
            fill_mask_holes(closed > 0).astype(np.uint8), around
        )  # back to the cells of the walls themselves
        self._over = walls_seen & (inside == 0) & (cv2.dilate(inside, disc(round(options.reach))) > 0)

    def __call__(self, samples: Points) -> Map:
        """Tell whether samples [K, 3] overhang, bool [K]."""
        return np.asarray(self._over[self._cells(samples, self._over)], bool)

    def _cells(self, samples: Points, plan: NDArray) -> tuple[NDArray[np.int64], ...]:
        return tuple(np.clip(self._grid.cells(samples), 0, np.array(plan.shape) - 1).T)
