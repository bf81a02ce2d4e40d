# SPDX-License-Identifier: GPL-3.0-or-later
"""Height of the ground around the building, the zero of heights in drawings and solids."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.drawings.model import Facade, Survey
from mgf_engine.drawings.project import Grid, plan_grid, render_grid

TERRAIN, MESH = "terrain", "mesh"
_PIXELS = 400  # longest side of the map of the ground plan


@dataclass(frozen=True)
class Ground:
    """A height in the local frame, and whether points of the terrain around the building tell it, or the mesh's lower
    end."""

    height: float
    source: str


def ground_of(survey: Survey, facades: list[Facade]) -> Ground:
    """Return the ground around a building that is drawn."""
    from mgf_engine.drawings.facades import plan_frame

    frame = plan_frame(survey, facades)
    grid = plan_grid(frame, float(frame.size.max()) / _PIXELS)
    seen = render_grid(survey, grid)
    return find_ground(survey, seen.face >= 0, seen.grid)


def find_ground(survey: Survey, inside: NDArray[np.bool_], grid: Grid) -> Ground:
    """Find the height of the ground: of the terrain's points around the building, else of the mesh's lower end."""
    z = survey.mesh.vertices[:, 2]
    bottom, height = float(np.percentile(z, 0.5)), float(np.ptp(z))
    scene = survey.scene
    points = survey.local(scene.to_normalised.invert(scene.points[~survey.masks.point_mask]))
    row, column = np.nonzero(inside)
    if not len(row) or not len(points):
        return Ground(bottom, MESH)
    plan = grid.places(np.stack([column, row], 1).astype(np.float64) + 0.5)
    reach = 0.3 * float(np.linalg.norm(np.ptp(plan, axis=0)))
    near = ((points[:, :2] > plan.min(0) - reach) & (points[:, :2] < plan.max(0) + reach)).all(1)
    near &= np.abs(points[:, 2] - bottom) < 0.2 * height
    column, row = np.floor(grid.pixels(points[:, :2])).astype(np.int64).T
    within = (column >= 0) & (column < grid.width) & (row >= 0) & (row < grid.height)
    near[within] &= ~inside[row[within], column[within]]
    if near.sum() < 30:
        return Ground(bottom, MESH)
    low, found, high = np.percentile(points[near, 2], (25, 50, 75)).tolist()
    level = high - low < 0.1 * height and abs(found - bottom) < 0.15 * height
    return Ground(found, TERRAIN) if level else Ground(bottom, MESH)
