# SPDX-License-Identifier: GPL-3.0-or-later
"""A textured wall seen by a row of cameras: photos, depths and tracks known exactly."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from mgf_engine.model.masks import MaskSet
from mgf_engine.model.scene import Scene, Similarity, View

WIDTH, HEIGHT, FOCAL = 192, 144, 180.0
_TEXTURE_SCALE = 100.0  # texture pixels per unit


def texture(seed: int = 0) -> np.ndarray:
    """A wall of random detail at several scales, RGB uint8 [600, 600, 3]."""
    random = np.random.default_rng(seed)
    wall = np.zeros((600, 600, 3))
    for cell in (4, 12, 40):
        small = random.random((600 // cell + 1, 600 // cell + 1, 3)).astype(np.float32)
        wall += cv2.resize(small, (600, 600), interpolation=cv2.INTER_CUBIC)
    return np.clip(wall / 3 * 255, 0, 255).astype(np.uint8)


def wall_view(name: str, centre: np.ndarray, roll: float = 0.0) -> View:
    """A camera at ``centre`` that looks along +z, rolled about its axis by ``roll`` radians."""
    c, s = np.cos(roll), np.sin(roll)
    rotation = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])
    return View(
        name=name, file=f"images/{name}.png", width=WIDTH, height=HEIGHT, fx=FOCAL, fy=FOCAL, cx=WIDTH / 2,
        cy=HEIGHT / 2, rotation=rotation, translation=-rotation @ centre, original_width=WIDTH, original_height=HEIGHT,
    )  # fmt: skip


def draw_wall(view: View, wall: np.ndarray) -> np.ndarray:
    """The wall z = 0 (x and y in -3..3) as the view sees it, RGB."""
    # continuous wall pixel (u, v) -> world ((u / scale - 3), (v / scale - 3), 0)
    to_world = np.array([[1 / _TEXTURE_SCALE, 0, -3], [0, 1 / _TEXTURE_SCALE, -3], [0, 0, 1]])
    k = view.intrinsics
    matrix = k @ np.c_[view.rotation[:, :2], view.translation] @ to_world
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    return cv2.warpPerspective(wall, np.linalg.inv(half) @ matrix @ half, (view.width, view.height))


def make_wall(folder: Path, centres: list[list[float]], rolls: list[float] | None = None) -> tuple[Scene, MaskSet]:
    """The wall photographed from ``centres`` into ``folder``, with 300 points on it, and masks that are full."""
    rolls = rolls or [0.0] * len(centres)
    views = [wall_view(f"v{i}", np.array(c, float), r) for i, (c, r) in enumerate(zip(centres, rolls, strict=True))]
    (folder / "images").mkdir(exist_ok=True)
    wall = texture()
    for view in views:
        cv2.imwrite(str(folder / view.file), draw_wall(view, wall)[:, :, ::-1])
    random = np.random.default_rng(1)
    points = np.c_[random.uniform(-1.2, 1.2, (300, 2)), np.zeros(300)]
    seen = []
    for i, view in enumerate(views):
        uv, depth = view.project(points)
        inside = (depth > 0) & (uv > 0).all(1) & (uv < (WIDTH, HEIGHT)).all(1)
        seen += [(p, i, *uv[p]) for p in np.flatnonzero(inside)]
    seen.sort()
    owner = np.array([s[0] for s in seen])
    scene = Scene(
        views=tuple(views), points=points, colors=np.full((300, 3), 128, np.uint8),
        errors=np.zeros(300, np.float32), track_start=np.searchsorted(owner, np.arange(301)).astype(np.int64),
        track_view=np.array([s[1] for s in seen], np.int32),
        track_uv=np.array([s[2:] for s in seen], np.float32),
        to_normalised=Similarity(1.0, np.eye(3), np.zeros(3)), roots=(0,), held_out=(), folder=folder,
    )  # fmt: skip
    masks = MaskSet(
        labels=tuple(np.ones((HEIGHT, WIDTH), np.uint8) for _ in views), used=np.ones(len(views), bool),
        scores=np.ones(len(views), np.float32), point_mask=np.ones(300, bool),
    )  # fmt: skip
    return scene, masks
