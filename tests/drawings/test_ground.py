# SPDX-License-Identifier: GPL-3.0-or-later
"""Height of the ground: by the terrain's points around the building, else by the mesh."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mgf_engine.drawings.ground import MESH, TERRAIN, GroundLevel, find_ground_level_around
from mgf_engine.drawings.model import DrawingFrame
from mgf_engine.drawings.project import Grid
from mgf_engine.model.scene import Similarity

#: The building stands on 0..10 of both axes and is 8 high from 2 up; the terrain's points lie around it.
BOTTOM, HEIGHT = 2.0, 8.0


def level(points: np.ndarray, on_building: bool = False, covered: bool = True) -> GroundLevel:
    frame = DrawingFrame("plan", np.zeros(3), *np.eye(3)[:2], np.zeros(2), np.full(2, 12.0))
    grid = Grid(frame, 0.5, -1.0, 11.0, 24, 24)
    inside = np.zeros((24, 24), bool)
    inside[2:22, 2:22] = covered
    z = np.linspace(BOTTOM, BOTTOM + HEIGHT, 201)
    survey = SimpleNamespace(
        mesh=SimpleNamespace(vertices=np.stack([z, z, z], 1)),
        scene=SimpleNamespace(points=points, to_normalised=Similarity(1.0, np.eye(3), np.zeros(3))),
        masks=SimpleNamespace(point_mask=np.full(len(points), on_building)),
        local=lambda at: at,
    )
    return find_ground_level_around(survey, inside, grid)  # type: ignore[arg-type]


def around(z: float, noise: float = 0.0, count: int = 80) -> np.ndarray:
    """Points beside the building."""
    rng = np.random.default_rng(0)
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.stack([5 + 8 * np.cos(angle), 5 + 8 * np.sin(angle), z + noise * rng.uniform(-1, 1, count)], 1)


def test_terrain_around_the_building_tells_its_height_and_spread() -> None:
    found = level(around(2.3, 0.1))
    assert found.source == TERRAIN and found.height == pytest.approx(2.3, abs=0.05)
    assert 0.05 < found.spread < 0.15


@pytest.mark.parametrize(
    "points,on_building",
    [
        (np.zeros((0, 3)), False),
        (around(2.3), True),  # points on the building are none of the terrain
        (around(2.3, count=20), False),  # too few
        (around(2.3, 1.5), False),  # too uneven
        (around(3.4), False),  # too far above the mesh's end
        (around(9.0), False),  # a tree
        (around(2.3) + np.array([100, 0, 0]), False),  # far away
        (around(2.3) * (0.4, 0.4, 1) + np.array([3, 3, 0]), False),  # below the building
    ],
)
def test_else_the_lower_end_of_the_mesh_does(points: np.ndarray, on_building: bool) -> None:
    found = level(points, on_building)
    assert found.source == MESH and found.spread == 0.0
    assert found.height == pytest.approx(BOTTOM, abs=0.01 * HEIGHT)


def test_without_a_ground_plan_the_mesh_does() -> None:
    assert level(around(2.3), covered=False).source == MESH
