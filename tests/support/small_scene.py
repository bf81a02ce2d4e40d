# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes of a few cameras and points that a test writes down."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from mgf_engine.model.scene import Scene, Similarity, View


def view(name: str, x: float, **changes: object) -> View:
    """A camera at (x, 0, 0) looking along +z; a point at depth 1 on the axis falls on the middle of 20 x 10 px."""
    base = View(name, name, 20, 10, 10.0, 10.0, 10.0, 5.0, np.eye(3), np.array([-x, 0, 0.0]), 20, 10)
    return replace(base, **changes)


def make_scene(views: list[View], points: np.ndarray, tracks: list[list[tuple[int, float, float]]]) -> Scene:
    flat = [o for t in tracks for o in t]
    return Scene(
        tuple(views), points, np.zeros((len(points), 3), np.uint8), np.zeros(len(points), np.float32),
        np.cumsum([0] + [len(t) for t in tracks]), np.array([o[0] for o in flat], np.int32),
        np.array([o[1:] for o in flat], np.float32).reshape(-1, 2), Similarity(1.0, np.eye(3), np.zeros(3)), (0,), (),
        Path("."),
    )  # fmt: skip


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
