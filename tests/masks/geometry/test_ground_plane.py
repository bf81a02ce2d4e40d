# SPDX-License-Identifier: GPL-3.0-or-later
"""The ground is a level plane below the cameras and below nearly all points, or there is none."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from support.analytic import camera
from support.small_scene import make_scene, view

from mgf_engine.masks.geometry.ground_plane import GroundPlane, GroundPlaneOptions, find_ground_plane
from mgf_engine.masks.geometry.point_features import measure_point_features
from mgf_engine.model.scene import Scene

LOOKING_NORTH = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # z up


def plane(height: float, count: int = 400, slope: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-5, 5, (2, count))
    return np.stack([x, y, height + slope * x + rng.normal(0, 0.005, count)], 1)


def scene(points: np.ndarray, camera_height: float) -> Scene:
    centres = [np.array([x, -12.0, camera_height]) for x in (-2.0, 0.0, 2.0)]
    views = [view(f"{k}", 0, rotation=LOOKING_NORTH, translation=-LOOKING_NORTH @ c) for k, c in enumerate(centres)]
    return make_scene(views, points, [[] for _ in points])


def ground_of(points: np.ndarray, camera_height: float, options: GroundPlaneOptions = GroundPlaneOptions()):
    made = scene(points, camera_height)
    return find_ground_plane(made, measure_point_features(made), np.ones(len(points)), 0, options)


def test_a_lawn_is_the_ground_and_points_on_it_are_rated() -> None:
    wall = np.stack([np.linspace(-2, 2, 200), np.zeros(200), np.random.default_rng(0).uniform(0.5, 3, 200)], 1)
    points = np.concatenate([plane(0.0), wall])
    made = scene(points, 1.6)
    features = measure_point_features(made)
    found = find_ground_plane(made, features, np.ones(len(points)), 0)
    assert isinstance(found, GroundPlane) and found.normal @ [0, 0, 1.0] > 0.999
    assert np.abs(found.height(np.array([[1.0, 2.0, 0.0], [0, 0, 2.0]])) - [0, 2]).max() < 0.05


@pytest.mark.parametrize(("camera_height", "there"), [(9.0, True), (1.5, False)])
def test_a_level_plane_above_the_cameras_is_a_ceiling(camera_height: float, there: bool) -> None:
    assert (ground_of(plane(6.0), camera_height) is not None) == there


def test_a_roof_with_points_below_it_is_no_ground() -> None:
    below = np.random.default_rng(1).uniform((-4, -4, 0), (4, 4, 4), (300, 3))
    assert ground_of(np.concatenate([plane(5.0), below]), 9.0) is None


def test_steep_planes_and_few_points_are_none() -> None:
    assert ground_of(plane(0.0, slope=0.8), 9.0) is None
    assert ground_of(plane(0.0, count=30), 9.0, GroundPlaneOptions(least_support=40)) is None


@pytest.mark.parametrize(("level", "there"), [(14, True), (6, False)])
def test_enough_of_the_points_lie_on_it(level: int, there: bool) -> None:
    """Thirty level points at heights of their own, and some at one height below them."""
    rng = np.random.default_rng(0)
    points = np.c_[rng.uniform(-5, 5, (30 + level, 2)), np.r_[np.arange(1.0, 31.0), np.zeros(level)]]
    features = SimpleNamespace(
        up=np.array([0.0, 0.0, 1.0]), normals=np.tile([0.0, 0.0, 1.0], (len(points), 1)),
        flatness=np.ones(len(points)), spacing=np.full(len(points), 0.1),
    )  # fmt: skip
    options = GroundPlaneOptions(least_support=20, trials=3000)
    found = find_ground_plane(scene(points, 40.0), features, np.ones(len(points)), 0, options)  # type: ignore[arg-type]
    assert (found is not None) == there
    assert found is None or found.level == pytest.approx(0.0, abs=1e-9)


def test_depth_of_the_ground_is_that_of_its_points() -> None:
    ground, above = GroundPlane(np.array([0.0, 0.0, 1.0]), 0.5, 0.01), camera((4.0, 1.0, 3.0))
    uv, wanted = above.project(np.array([[0.2, 0.5, 0.5], [-1.0, 0.3, 0.5]]))
    for scale in (1, 2):  # a map of half the photo's size has the same depths
        depth = ground.depth(above, above.height // scale, above.width // scale)
        column, row = np.floor(uv.T / scale).astype(int)
        np.testing.assert_allclose(depth[row, column], wanted, rtol=0.01 * scale)


def test_rays_over_the_horizon_never_meet_the_ground() -> None:
    ground, level = GroundPlane(np.array([0.0, 0.0, 1.0]), 0.0, 0.01), camera((4.0, 1.0, 3.0), target=(0.0, 0.0, 3.0))
    depth = ground.depth(level, level.height, level.width)
    assert np.isinf(depth[: level.height // 2]).all()
    assert np.isfinite(depth[level.height // 2 :]).all()
