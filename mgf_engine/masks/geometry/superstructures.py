# SPDX-License-Identifier: GPL-3.0-or-later
"""Find superstructures, such as spires and chimneys: points above the roof, too sparse for the surface model."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.geometry.plan_grid import PlanGrid, cells_inside
from mgf_engine.masks.geometry.point_features import PointFeatures
from mgf_engine.masks.image_ops import disc, fill_mask_holes
from mgf_engine.options.algorithms import parameter
from mgf_engine.scene.gravity import horizontal_axes

_FEWEST = 10  # points of a building that has a ground plan


@dataclass(frozen=True)
class SuperstructureOptions:
    """Options of what stands on the roof."""

    height: float = parameter(0.7, "Minimum height above the lowest points, as a share of the building's height around")
    side: int = parameter(64, "Number of cells along the longer side of the plan", low=4)
    gap: float = parameter(0.12, "Half width of gaps that belong to the plan, as a share of its longer side", high=1)


def find_superstructures(
    points: NDArray[np.float64],
    keep: NDArray[np.bool_],
    features: PointFeatures,
    options: SuperstructureOptions = SuperstructureOptions(),
) -> NDArray[np.bool_]:
    """Return points that stand on the building: above its ground plan and not low, bool [P].

    Args:
        points: [P, 3].
        keep: points of the building, bool [P].
        features: direction of "up" and what is known of each point.
        options: how high points must lie, and of the plan below them.
    """
    keep = features.supported(keep)
    if keep.sum() < _FEWEST:
        return np.zeros(len(points), bool)
    axes, height = horizontal_axes(features.up), points @ features.up
    plan = (points @ axes.T)[keep]
    low, high = plan.min(0), plan.max(0)
    grid = PlanGrid(axes, low, max(float((high - low).max()) / options.side, 1e-9))
    reach = round(options.gap * options.side)
    size = np.ceil((high - low) / grid.cell).astype(int) + 1 + 2 * reach
    at = grid.cells(points) + reach
    mapped, at = cells_inside(at, size), np.clip(at, 0, size - 1)
    top = np.full(size, -np.inf, np.float32)
    np.maximum.at(top, tuple(at[keep].T), height[keep])
    closed = cv2.morphologyEx(np.isfinite(top).astype(np.uint8), cv2.MORPH_CLOSE, disc(reach))
    area = fill_mask_holes(cv2.dilate(closed, np.ones((3, 3), np.uint8)) > 0)
    floor = float(np.percentile(height[keep], 1))
    tall = cv2.dilate(np.where(np.isfinite(top), top - floor, 0).astype(np.float32), disc(reach))
    tall[tall <= 0] = np.percentile(height[keep], 95) - floor  # far inside, where no point tells
    x, y = at.T
    return np.asarray(mapped & area[x, y] & (height - floor > options.height * tall[x, y]), bool)
