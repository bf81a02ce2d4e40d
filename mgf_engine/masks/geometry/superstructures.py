# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands on the building above its roof, as spires and chimneys do: few points, too far apart for its surface."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.algorithms import parameter
from mgf_engine.masks.geometry.ground_plan import GroundPlan, GroundPlanOptions
from mgf_engine.masks.geometry.plan_grid import inside
from mgf_engine.masks.geometry.point_features import PointFeatures
from mgf_engine.masks.image_ops import disc

_FEWEST = 10  # points of a building that has a ground plan


@dataclass(frozen=True)
class SuperstructureOptions:
    """Options of what stands on the roof."""

    height: float = parameter(0.7, "Minimum height above the lowest points, as a share of the building's height around")
    around: float = parameter(
        0.12, "Radius in which the building's height is its greatest, as a share of the longer side of the plan", high=1
    )
    plan: GroundPlanOptions = GroundPlanOptions()


def find_superstructures(
    points: NDArray[np.float64],
    keep: NDArray[np.bool_],
    shape: PointFeatures,
    options: SuperstructureOptions = SuperstructureOptions(),
) -> NDArray[np.bool_]:
    """Return points that stand on the building: above its ground plan and not low, bool [P].

    Args:
        points: [P, 3].
        keep: points of the building, bool [P].
        shape: direction of "up" and what is known of each point.
        options: how high points must lie, and of the plan.
    """
    keep = shape.supported(keep)
    if keep.sum() < _FEWEST:
        return np.zeros(len(points), bool)
    plan, height = GroundPlan.of(points[keep], shape.up, options.plan), points @ shape.up
    at = plan.grid.cells(points)
    mapped, at = inside(at, plan.area.shape), np.clip(at, 0, np.array(plan.area.shape) - 1)
    top = np.full(plan.area.shape, -np.inf, np.float32)
    own = keep & mapped
    np.maximum.at(top, tuple(at[own].T), height[own])
    floor = float(np.percentile(height[keep], 1))
    raised = np.where(np.isfinite(top), top - floor, 0).astype(np.float32)
    tall = cv2.dilate(raised, disc(round(options.around * options.plan.side)))
    tall[tall <= 0] = np.percentile(height[keep], 95) - floor  # far inside, where no point tells
    area = cv2.dilate(plan.area.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    x, y = at.T
    return np.asarray(mapped & area[x, y] & (height - floor > options.height * tall[x, y]), bool)
