# SPDX-License-Identifier: GPL-3.0-or-later
"""Height of the ground around the building, the zero of heights in drawings and solids."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.drawings.facades import plan_frame
from mgf_engine.drawings.model import Facade, Survey
from mgf_engine.drawings.project import Grid, plan_grid, render_grid
from mgf_engine.options.algorithms import parameter

TERRAIN, MESH = "terrain", "mesh"


@dataclass(frozen=True)
class GroundLevelOptions:
    """Options of the height of the ground around a building."""

    plan_side: int = parameter(400, "Longest side of the map of the ground plan", "px", low=16)
    bottom: float = parameter(0.5, "Percentile of the mesh's heights that is its lower end", high=100)
    reach: float = parameter(
        0.3, "Distance from the ground plan within which points are terrain, as a share of the plan's diagonal"
    )
    height: float = parameter(
        0.2,
        "Distance in height from the lower end within which points are terrain, as a share of the height",
        high=1,
    )
    least_points: int = parameter(30, "Minimum number of points of the terrain", low=1)
    uneven: float = parameter(
        0.1, "Distance between the quartiles of the terrain's heights from which it is uneven, as a share of the height"
    )
    apart: float = parameter(
        0.15, "Distance between terrain and lower end from which the terrain is another, as a share of the height"
    )


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


def find_ground_level(
    survey: Survey, facades: list[Facade], options: GroundLevelOptions = GroundLevelOptions()
) -> GroundLevel:
    """Find the height of the ground around a building with these facades."""
    frame = plan_frame(survey, facades)
    grid = plan_grid(frame, float(frame.size.max()) / options.plan_side)
    seen = render_grid(survey, grid)
    return find_ground_level_around(survey, seen.face >= 0, seen.grid, options)


def find_ground_level_around(
    survey: Survey, inside: NDArray[np.bool_], grid: Grid, options: GroundLevelOptions = GroundLevelOptions()
) -> GroundLevel:
    """Find the height of the ground: of the terrain's points around the building, else of the mesh's lower end.

    Args:
        survey: mesh and sparse points.
        inside: pixels of the ground plan that the building covers, bool [H, W].
        grid: of the ground plan.
        options: which points are terrain, and when it counts.
    """
    z = survey.mesh.vertices[:, 2]
    bottom, height = float(np.percentile(z, options.bottom)), float(np.ptp(z))
    scene = survey.scene
    points = survey.local(scene.to_normalised.invert(scene.points[~survey.masks.point_mask]))
    row, column = np.nonzero(inside)
    if not len(row) or not len(points):
        return GroundLevel(bottom, MESH)
    plan = grid.places(np.stack([column, row], 1).astype(np.float64) + 0.5)
    reach = options.reach * float(np.linalg.norm(np.ptp(plan, axis=0)))
    near = ((points[:, :2] > plan.min(0) - reach) & (points[:, :2] < plan.max(0) + reach)).all(1)
    near &= np.abs(points[:, 2] - bottom) < options.height * height
    near &= ~grid.look_up(inside, points, False)
    if near.sum() < options.least_points:
        return GroundLevel(bottom, MESH)
    low, found, high = np.percentile(points[near, 2], (25, 50, 75)).tolist()
    level = high - low < options.uneven * height and abs(found - bottom) < options.apart * height
    return GroundLevel(found, TERRAIN, high - low) if level else GroundLevel(bottom, MESH)
