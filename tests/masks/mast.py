# SPDX-License-Identifier: GPL-3.0-or-later
"""A hut with a steel mast beside it, photographed from a ring of cameras: sky above, ground below, bars between."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.model.scene import Scene, Similarity, View

WIDTH, HEIGHT, FOCAL = 240, 160, 200.0
UP = np.array([0.0, 0.0, 1.0])
SKY, LAND, STEEL, BRICK, LEAF = (190, 210, 235), (110, 120, 70), (70, 75, 85), (150, 70, 55), (60, 110, 40)
LEGS = np.array([(0.9, -0.15), (1.2, -0.15), (1.2, 0.15), (0.9, 0.15)])
TOP = 1.6


def look(angle: float, height: float, distance: float = 5.0) -> View:
    """A camera on a ring that looks level at the middle."""
    centre = np.array([distance * np.cos(angle), distance * np.sin(angle), height])
    forward = np.array([-np.cos(angle), -np.sin(angle), 0.0])
    right = np.cross(forward, UP)
    rotation = np.stack([right, -UP, forward])
    name = f"{angle:.2f}-{height:.1f}.png"
    return View(name, name, WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, rotation, -rotation @ centre,
                WIDTH, HEIGHT)  # fmt: skip


def bars() -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """The mast's bars as pairs of ends: four legs, rings and a platform's edge at the top."""
    corners = [np.array([x, y, z]) for z in (0.0, 0.5, 1.0, TOP) for x, y in LEGS]
    legs = [(corners[i], corners[12 + i]) for i in range(4)]
    rings = [(corners[4 * k + i], corners[4 * k + (i + 1) % 4]) for k in (1, 2, 3) for i in range(4)]
    return legs + rings


def photograph(view: View, tree: bool = False) -> tuple[NDArray[np.uint8], NDArray[np.bool_], NDArray[np.bool_]]:
    """The photo, the hut's pixels and the mast's pixels."""
    photo = np.empty((HEIGHT, WIDTH, 3), np.uint8)
    photo[:] = SKY
    horizon = round(view.cy)
    photo[horizon:] = LAND
    hut, mast = np.zeros((2, HEIGHT, WIDTH), np.uint8)
    box = np.array([(x, y, z) for x in (-0.4, 0.4) for y in (-0.4, 0.4) for z in (0.0, 0.6)])
    cv2.fillConvexPoly(hut, cv2.convexHull(np.round(view.project(box)[0]).astype(np.int32)), 1)
    for start, end in bars():
        (x0, y0), (x1, y1) = np.round(view.project(np.stack([start, end]))[0]).astype(int)
        cv2.line(mast, (x0, y0), (x1, y1), 1, 2)
    if tree:
        x, y = view.project(np.array([[1.05, 0.0, 1.9]]))[0][0]
        cv2.circle(photo, (round(x), round(y)), 9, LEAF, -1)
    photo[hut > 0], photo[mast > 0] = BRICK, STEEL
    return photo, hut > 0, mast > 0


def make_scene(folder: Path, views: list[View], tree: bool = False) -> Scene:
    """A scene of the hut's points alone: on the mast nothing was found."""
    folder.mkdir(parents=True, exist_ok=True)
    for view in views:
        cv2.imwrite(str(folder / view.file), photograph(view, tree)[0][..., ::-1])
    rng = np.random.default_rng(0)
    points = rng.uniform((-0.4, -0.4, 0.0), (0.4, 0.4, 0.6), (60, 3))
    count = len(points)
    return Scene(
        views=tuple(views), points=points, colors=np.zeros((count, 3), np.uint8), errors=np.zeros(count, np.float32),
        track_start=np.arange(count + 1), track_view=np.zeros(count, np.int32),
        track_uv=np.full((count, 2), 1.0, np.float32), to_normalised=Similarity(1.0, np.eye(3), np.zeros(3)),
        roots=(0,), held_out=(), folder=folder,
    )  # fmt: skip
