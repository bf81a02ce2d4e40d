# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

import numpy as np

from mgf_engine.masks.geometry.overhangs import Overhangs
from mgf_engine.model.scene import Scene
from tests.masks.test_points import make_scene, view


def photos(centres: np.ndarray, rotations: list[np.ndarray]) -> Scene:
    poses = [{"rotation": r, "translation": -r @ c} for r, c in zip(rotations, centres, strict=True)]
    return make_scene([view(f"{i}.jpg", i, **pose) for i, pose in enumerate(poses)], np.zeros((0, 3)), [])


def grid(columns: int, rows: int) -> np.ndarray:
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, 9.0)], 1).astype(float)


def tilted(count: int, degrees: float) -> list[np.ndarray]:
    """Cameras straight down (z up) whose axes are off by a few degrees."""
    rng, down = np.random.default_rng(1), np.diag([1.0, -1.0, -1.0])
    result = []
    for a, b in np.radians(rng.normal(0, degrees, (count, 2))):
        x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
        y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
        result.append(x @ y @ down)
    return result


def test_under_photos_straight_down_roofs_reach_the_ground() -> None:
    x, y = np.meshgrid(np.arange(0, 20.0), np.arange(0, 20.0))
    roof = np.stack([x.ravel(), y.ravel(), np.full(x.size, 12.0)], 1)
    z = np.arange(0, 12.0)
    walls = np.concatenate([[[a, b, c] for c in z] for a in range(3, 17) for b in (3, 16)] +
                           [[[a, b, c] for c in z] for b in range(3, 17) for a in (3, 16)])  # fmt: skip
    eave = np.array([[1.2, 10.0, 5.0]])
    points, up = np.concatenate([roof, walls.astype(float)]), np.array([0.0, 0, 1])
    assert Overhangs(points, up, 1.0)(eave).all()
    assert not Overhangs(points, up, 1.0, walls_seen=False)(eave).any()
