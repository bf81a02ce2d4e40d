# SPDX-License-Identifier: GPL-3.0-or-later
"""Height of the ground around the building, the zero of heights in drawings and solids."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.drawings.facades import plan_frame
from mgf_engine.drawings.model import Facade, Survey
from mgf_engine.drawings.project import Grid, plan_grid, render_grid

TERRAIN, MESH = "terrain", "mesh"
_PIXELS = 400  # longest side of the map of the ground plan


@dataclass(frozen=True)
class GroundLevel:
    """The ground around the building.

    Attributes:
        height: in the local frame.
        source: what tells it, points of the ``TERRAIN`` around the building or the lower end of the ``MESH``.
        spread: distance between the quartiles of the terrain's heights; 0 where the mesh tells it.
    """

    height: float
    source: str
    spread: float = 0.0


def find_ground_level(survey: Survey, facades: list[Facade]) -> GroundLevel:
    """Find the height of the ground around a building with these facades."""
    frame = plan_frame(survey, facades)
    grid = plan_grid(frame, float(frame.size.max()) / _PIXELS)
    seen = render_grid(survey, grid)
    return find_ground_level_around(survey, seen.face >= 0, seen.grid)


def find_ground_level_around(survey: Survey, inside: NDArray[np.bool_], grid: Grid) -> GroundLevel:
    """Find the height of the ground: of the terrain's points around the building, else of the mesh's lower end.

    Args:
        survey: mesh and sparse points.
        inside: pixels of the ground plan that the building covers, bool [H, W].
        grid: of the ground plan.
    """
    z = survey.mesh.vertices[:, 2]
    bottom, height = float(np.percentile(z, 0.5)), float(np.ptp(z))
    scene = survey.scene
    points = survey.local(scene.to_normalised.invert(scene.points[~survey.masks.point_mask]))
    row, column = np.nonzero(inside)
    if not len(row) or not len(points):
        return GroundLevel(bottom, MESH)
    plan = grid.places(np.stack([column, row], 1).astype(np.float64) + 0.5)
    reach = 0.3 * float(np.linalg.norm(np.ptp(plan, axis=0)))
    near = ((points[:, :2] > plan.min(0) - reach) & (points[:, :2] < plan.max(0) + reach)).all(1)
    near &= np.abs(points[:, 2] - bottom) < 0.2 * height
    near &= ~grid.look_up(inside, points, False)
    if near.sum() < 30:
        return GroundLevel(bottom, MESH)
    low, found, high = np.percentile(points[near, 2], (25, 50, 75)).tolist()
    level = high - low < 0.1 * height and abs(found - bottom) < 0.15 * height
    return GroundLevel(found, TERRAIN, high - low) if level else GroundLevel(bottom, MESH)
