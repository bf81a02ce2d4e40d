# SPDX-License-Identifier: GPL-3.0-or-later
"""A dense wall sampled as finely as its points ask for, and only as finely as the maps show."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from mgf_engine.masks.shape import measure_shape
from mgf_engine.masks.surface import Surface, make_surface
from mgf_engine.scene.model import Scene, Similarity
from tests.masks.test_extent import camera

SIZE = (100, 150)


def wall(coarse: float) -> Surface:
    """4 x 2 units of wall, 5 units before the camera, 20,000 points."""
    rng = np.random.default_rng(2)
    points = np.stack([rng.uniform(-2, 2, 20_000), np.full(20_000, -1.0), rng.uniform(1, 3, 20_000)], 1)
    blank = _scene(points)
    shape = measure_shape(blank)
    return make_surface(blank, shape, np.ones(len(points), bool), None, discs=True, columns=False, coarse=coarse)


def _scene(points: np.ndarray) -> Scene:
    return Scene(
        (camera(0),), points, np.zeros((len(points), 3), np.uint8), np.zeros(len(points), np.float32),
        np.zeros(len(points) + 1, np.int64), np.zeros(0, np.int32), np.zeros((0, 2), np.float32),
        Similarity(1.0, np.eye(3), np.zeros(3)), (0,), (), Path("."),
    )  # fmt: skip


def test_coarse_samples_are_fewer_and_show_the_same_wall():
    fine, coarse = wall(0.0), wall(0.06)
    assert len(coarse.samples) < len(fine.samples) / 3
    assert coarse.tolerance == fine.tolerance == pytest.approx(fine.cell)
    depths = [surface.depth(camera(0), *SIZE) for surface in (fine, coarse)]
    seen = [np.isfinite(depth) for depth in depths]
    rim = cv2.morphologyEx(seen[0].astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((5, 5), np.uint8)) > 0
    assert not ((seen[0] ^ seen[1]) & ~rim).any() and seen[0].mean() > 0.3
    assert depths[0][seen[0] & seen[1]] == pytest.approx(5.0, abs=0.01)
    assert depths[1][seen[0] & seen[1]] == pytest.approx(5.0, abs=0.01)


def test_projection_is_that_of_the_view():
    surface, view = wall(0.06), camera(0.3)
    pixels, depth, radius = surface.project(view, *SIZE)
    uv, true = view.project(surface.samples)
    seen = (true > 0) & (uv >= 0).all(1) & (uv < (view.width, view.height)).all(1)
    assert abs(len(pixels) - seen.sum()) < 5
    inside = np.floor(uv[seen] / 2).astype(int)
    assert len(pixels) == len(inside) and (np.abs(pixels - inside).max(1) <= 1).all()
    assert (pixels == inside).all(1).mean() > 0.999
    assert depth == pytest.approx(true[seen], rel=1e-5)
    assert radius == pytest.approx(surface.spacing[seen] * view.fx / true[seen] / 2, rel=1e-4)


def test_what_is_behind_the_camera_is_not_seen():
    surface = wall(0.0)
    behind = Surface(surface.samples - [0, 20, 0], surface.spacing, surface.cell, surface.tolerance)
    assert not len(behind.project(camera(0), *SIZE)[0])
    assert np.isinf(behind.depth(camera(0), *SIZE)).all()
