# SPDX-License-Identifier: GPL-3.0-or-later
"""A dense wall sampled as finely as its points ask for, and only as finely as the maps show."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from support.level_camera import camera

from mgf_engine.masks.geometry.ground_plane import GroundPlane
from mgf_engine.masks.geometry.overhangs import Overhangs
from mgf_engine.masks.geometry.point_features import measure_point_features
from mgf_engine.masks.geometry.point_surface import (
    Columns,
    SampledSurface,
    SurfaceOptions,
    _first_of_each,
    make_surface,
)
from mgf_engine.model.scene import Scene, Similarity, View

SIZE = (100, 150)


def wall(coarse: float) -> SampledSurface:
    """4 x 2 units of wall, 5 units before the camera, 20,000 points."""
    rng = np.random.default_rng(2)
    points = np.stack([rng.uniform(-2, 2, 20_000), np.full(20_000, -1.0), rng.uniform(1, 3, 20_000)], 1)
    blank = _scene(points)
    features = measure_point_features(blank)
    return make_surface(blank, features, np.ones(len(points), bool), discs=True, coarse=coarse)


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
    places, depth, radius = surface.project(view, *SIZE)
    pixels = np.stack([places % SIZE[1], places // SIZE[1]], 1)
    uv, true = view.project(surface.samples)
    seen = (true > 0) & (uv >= 0).all(1) & (uv < (view.width, view.height)).all(1)
    assert abs(len(pixels) - seen.sum()) < 5
    inside = np.floor(uv[seen] / 2).astype(int)
    assert len(pixels) == len(inside) and (np.abs(pixels - inside).max(1) <= 1).all()
    assert (pixels == inside).all(1).mean() > 0.999
    assert depth == pytest.approx(true[seen], rel=1e-5)
    assert radius == pytest.approx(surface.spacing[seen] * view.fx / true[seen] / 2, rel=1e-4)


def nearest_disc(surface: SampledSurface, view: View, h: int, w: int) -> np.ndarray:
    """Plain reference: each sample's disc, its radius one of a few, drawn with its depth where nothing nearer is."""
    places, depth, _ = surface.project(view, h, w)
    radius = SurfaceOptions.splat * surface.cell * view.fx / depth * w / view.width
    level = np.clip(np.round(2 * np.log2(np.maximum(radius, 1))), 0, 2 * np.log2(max(h, w) / 4)).astype(int)
    result = np.full((h, w), np.inf, np.float32)
    for step in np.unique(level):
        spots = np.full(h * w, np.inf, np.float32)
        np.minimum.at(spots, places[level == step], depth[level == step])
        size = 2 * round(2 ** (step / 2)) + 1
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
        result = np.minimum(result, cv2.erode(spots.reshape(h, w), disc, borderValue=float("inf")))
    return result


@pytest.mark.parametrize("away", [3.0, 0.0, -3.5])
def test_depth_is_that_of_the_nearest_disc(away: float):
    wide = wall(0.0)
    rng = np.random.default_rng(1)
    rough = wide.samples + rng.normal(0, 0.3, wide.samples.shape) * (0, 1, 0) + (0, away, 0)
    surface = SampledSurface(rough, wide.spacing, wide.cell, wide.tolerance)
    expected = nearest_disc(surface, camera(0.3), *SIZE)
    found = surface.depth(camera(0.3), *SIZE)
    assert np.isfinite(expected).mean() > 0.1
    both = np.isfinite(found) & np.isfinite(expected)
    assert both.sum() > 0.999 * max(np.isfinite(found).sum(), np.isfinite(expected).sum())
    assert (np.abs(found[both] - expected[both]) > 1e-5).mean() < 1e-3


@pytest.mark.parametrize("most", [1, 50, 2**40, 2**62])
def test_the_first_of_each_key_is_that_of_unique(most: int):
    keys = np.random.default_rng(0).integers(0, most, 300)
    np.testing.assert_array_equal(_first_of_each(keys), np.unique(keys, return_index=True)[1])


def test_what_is_behind_the_camera_is_not_seen():
    surface = wall(0.0)
    behind = SampledSurface(surface.samples - [0, 20, 0], surface.spacing, surface.cell, surface.tolerance)
    assert not len(behind.project(camera(0), *SIZE)[0])
    assert np.isinf(behind.depth(camera(0), *SIZE)).all()


def house(rng: np.random.Generator) -> np.ndarray:
    """2,000 points on four walls of 4 x 3 units around the origin, from the ground up."""
    side, along, height = rng.integers(0, 4, 2000), rng.uniform(-2, 2, 2000), rng.uniform(0, 3, 2000)
    edge = np.where(side % 2, 2.0, -2.0)
    return np.stack([np.where(side < 2, along, edge), np.where(side < 2, edge, along), height], 1)


def columns_below(points: np.ndarray) -> np.ndarray:
    """Where the columns under these points are at half their height, [K, 2]."""
    blank = _scene(points)
    ground = GroundPlane(np.array([0.0, 0, 1]), 0.0, 0.01)
    features, every = measure_point_features(blank), np.ones(len(points), bool)
    over = Overhangs(points, features.up, float(np.median(features.spacing)))
    samples = make_surface(blank, features, every, discs=False, columns=Columns(over, ground)).samples
    return samples[np.abs(samples[:, 2] - 1.5) < 0.3, :2]


def test_eaves_reach_no_ground_but_walls_and_roofs_do():
    rng = np.random.default_rng(4)
    around = rng.uniform(-2.5, 2.5, (4000, 2))
    eaves = around[(np.abs(around).max(1) > 2.35) & (np.abs(around).max(1) < 2.5)]
    roof = rng.uniform(-1.9, 1.9, (300, 2))
    pavilion = rng.uniform(-0.6, 0.6, (80, 2)) + np.array([6.0, 0])  # nobody saw its walls
    tops = np.concatenate([eaves, roof, pavilion])
    points = np.concatenate([house(rng), np.column_stack([tops, rng.uniform(2.95, 3.05, len(tops))])])
    below = columns_below(points)
    outside = np.abs(below).max(1)
    assert ((outside > 1.9) & (outside < 2.1)).sum() > 50  # the walls
    assert (outside < 1.7).sum() > 100  # the roof between them
    assert not ((outside > 2.3) & (outside < 4)).any()  # the eaves
    assert (below[:, 0] > 5).sum() > 20  # the pavilion


def test_without_walls_every_roof_reaches_the_ground():
    rng = np.random.default_rng(5)
    points = np.column_stack([rng.uniform(-2, 2, (800, 2)), rng.uniform(2.95, 3.05, 800)])
    assert len(columns_below(points)) > 100
