# SPDX-License-Identifier: GPL-3.0-or-later
"""Up, ground, reach and occlusion on a wall of points that stands on a plane of points."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.level_camera import camera

from mgf_engine.masks.geometry.building_extent import BuildingExtent, _convex_hull, map_size
from mgf_engine.masks.geometry.ground_plane import _draws, find_ground_plane
from mgf_engine.masks.geometry.point_features import clicked_groups, measure_point_features
from mgf_engine.masks.geometry.point_visibility import PointVisibility
from mgf_engine.model.scene import Scene, Similarity, View
from mgf_engine.scene.gravity import up_from_cameras

WALL, GROUND = 600, 600


@pytest.fixture(scope="module")
def scene() -> Scene:
    rng = np.random.default_rng(0)
    wall = np.stack([rng.uniform(-2, 2, WALL), np.zeros(WALL), rng.uniform(0.8, 3, WALL)], 1)
    ground = np.stack([rng.uniform(-4, 4, GROUND), rng.uniform(-5, 0, GROUND), rng.normal(0, 0.005, GROUND)], 1)
    points = np.concatenate([wall, ground])
    views = tuple(camera(x) for x in (-0.6, 0.0, 0.6))
    track_view, track_uv, start = [], [], [0]
    for point in points:
        for k, view in enumerate(views):
            uv, _ = view.project(point[None])
            # The last view does not see the wall's right part: something stands before it.
            hidden = k == 2 and point[0] > 0.8 and point[1] == 0
            if (uv >= 0).all() and (uv < (300, 200)).all() and not hidden:
                track_view.append(k)
                track_uv.append(uv[0])
        start.append(len(track_view))
    count = len(points)
    return Scene(
        views, points, np.zeros((count, 3), np.uint8), np.zeros(count, np.float32), np.array(start),
        np.array(track_view, np.int32), np.array(track_uv, np.float32), Similarity(1.0, np.eye(3), np.zeros(3)), (0,),
        (), Path("."),
    )  # fmt: skip


@pytest.fixture(scope="module")
def extent(scene: Scene) -> BuildingExtent:
    features = measure_point_features(scene)
    ground = find_ground_plane(scene, features, np.repeat([0.0, 1.0], [WALL, GROUND]), 0)
    keep = np.repeat([True, False], [WALL, GROUND])
    return BuildingExtent(scene, features, keep, ground, PointVisibility(scene, features))


def at(plane: np.ndarray, view: View, point: list[float]) -> object:
    (u, v), _ = view.project(np.array([point]))[0][0], None
    h, w = plane.shape
    return plane[int(v * h / view.height), int(u * w / view.width)]


def test_up_and_normals(scene: Scene):
    assert up_from_cameras(scene.views) @ [0, 0, 1] > 0.999
    features = measure_point_features(scene)
    upright = np.abs(features.normals @ features.up)
    assert np.median(upright[:WALL]) < 0.05 and np.median(upright[WALL:]) > 0.95


def test_ground_is_found_and_holds_its_own_points(scene: Scene):
    features = measure_point_features(scene)
    ground = find_ground_plane(scene, features, np.repeat([0.0, 1.0], [WALL, GROUND]), 0)
    assert ground is not None
    assert ground.normal @ [0, 0, 1] > 0.999 and abs(ground.level) < 0.02
    held = ground.membership(scene, features) > 0.5
    assert held[WALL:].mean() > 0.95 and not held[:WALL].any()


def test_no_ground_without_points_outside(scene: Scene):
    assert find_ground_plane(scene, measure_point_features(scene), np.zeros(WALL + GROUND), 0) is None


@pytest.mark.parametrize("count", [4, 30, 2000])
def test_rows_are_drawn_as_numpy_draws_them(count: int):
    share = np.random.default_rng(count).random(count) ** 3
    share /= share.sum()
    rng, drawn = np.random.default_rng(1), list(_draws(np.random.default_rng(1), share, 200))
    assert len({tuple(three.tolist()) for three in drawn}) > 3
    for three in drawn:
        np.testing.assert_array_equal(three, rng.choice(count, 3, replace=False, p=share))


def test_core_reaches_down_to_the_ground_and_not_beyond_the_wall(scene: Scene, extent: BuildingExtent):
    place, view = extent.view_regions(1), scene.views[1]
    assert place.core.shape == map_size(view)
    assert at(place.core, view, [0, 0, 2]) and at(place.core, view, [0, 0, 0.3])  # no points below 0.8
    assert not at(place.core, view, [0, 0, 3.3]) and not at(place.core, view, [2.3, 0, 2])
    assert at(place.away, view, [0, 0, 2]) == 0 and at(place.away, view, [3.2, 0, 2]) > 3


def test_a_ray_that_meets_the_ground_within_the_plan_has_passed_a_wall(scene: Scene):
    """Few points on a front wall, many on side walls and roof: the gap in the front wall is no ground."""
    rng = np.random.default_rng(3)
    back = np.stack([rng.uniform(-2, 2, 400), np.full(400, 2.0), rng.uniform(0, 3, 400)], 1)
    sides = np.stack([rng.choice([-2.0, 2.0], 400), rng.uniform(0, 2, 400), rng.uniform(0, 3, 400)], 1)
    roof = np.stack([rng.uniform(-2, 2, 400), rng.uniform(0, 2, 400), np.full(400, 3.0)], 1)
    walls = np.concatenate([back, sides, roof])
    count = len(walls)
    with_ground = np.concatenate([walls, scene.points[WALL:]])
    none = np.zeros(0, np.int32)
    bare = replace(
        scene, points=with_ground, colors=np.zeros((len(with_ground), 3), np.uint8),
        errors=np.zeros(len(with_ground), np.float32), track_start=np.zeros(len(with_ground) + 1, np.int64),
        track_view=none, track_uv=np.zeros((0, 2), np.float32),
    )  # fmt: skip
    features = measure_point_features(bare)
    keep = np.arange(len(with_ground)) < count
    ground = find_ground_plane(bare, features, (~keep).astype(float), 0)
    assert ground is not None
    place = BuildingExtent(bare, features, keep, ground, PointVisibility(bare, features)).view_regions(1)
    view = bare.views[1]
    assert at(place.core, view, [0, 0, 0.4]) and not at(place.ground_first, view, [0, 0, 0.4])
    assert at(place.ground_first, view, [0, -0.6, 0]) and not at(place.core, view, [0, -0.6, 0])


def test_a_point_astray_adds_nothing(scene: Scene):
    """One point of the wall's top slid a few spacings along its line, into the air."""
    astray = replace(scene, points=scene.points.copy())
    first = int(np.argmax(scene.points[:WALL, 2] - np.abs(scene.points[:WALL, 0] - 1.8)))
    astray.points[first] = [2.4, 0, 2.8]
    features = measure_point_features(astray)
    keep = np.repeat([True, False], [WALL, GROUND])
    place = BuildingExtent(astray, features, keep, None, PointVisibility(astray, features)).view_regions(1)
    assert not at(place.reach, scene.views[1], [2.4, 0, 2.8]) and at(place.reach, scene.views[1], [1.8, 0, 2.8])


def test_ground_first(scene: Scene, extent: BuildingExtent):
    place, view = extent.view_regions(1), scene.views[1]
    assert at(place.ground_first, view, [0, -1.5, 0]) and at(place.ground_first, view, [2.5, -1, 0])
    assert not at(place.ground_first, view, [0, 0, 0.4]) and not at(place.ground_first, view, [2.5, 0, 2.5])


def test_within_is_what_is_seen_on_the_wall_or_through_it(scene: Scene, extent: BuildingExtent):
    within = extent.within(1, extent.view_regions(1))
    owner = extent.visibility.owner[scene.track_view == 1]
    assert within[owner < WALL].mean() > 0.95
    before = (owner >= WALL) & (scene.points[owner, 1] < -0.5)
    assert before.sum() > 50 and not within[before].any()


def test_hidden_where_expected_points_are_missing(scene: Scene, extent: BuildingExtent):
    right, left = [1.4, 0, 2.0], [-1.0, 0, 2.0]
    assert at(extent.view_regions(2).hidden, scene.views[2], right)
    assert not at(extent.view_regions(2).hidden, scene.views[2], left)
    assert not at(extent.view_regions(1).hidden, scene.views[1], right)


def test_nothing_kept(scene: Scene):
    features = measure_point_features(scene)
    empty = BuildingExtent(
        scene, features, np.zeros(WALL + GROUND, bool), None, PointVisibility(scene, features)
    ).view_regions(0)
    assert not empty.core.any() and not empty.ground_first.any() and not empty.hidden.any()


def test_a_second_building_without_clicks_is_another_group(scene: Scene):
    twice = np.concatenate([scene.points[:WALL], scene.points[:WALL] + np.array([9.0, 0, 0])])
    features = measure_point_features(scene)
    features = type(features)(**{**features.__dict__, "spacing": np.repeat(features.spacing[:WALL], 2)})
    keep = np.ones(2 * WALL, bool)
    groups = clicked_groups(twice, keep, np.array([5]), features)
    assert groups[:WALL].all() and not groups[WALL:].any()
    assert clicked_groups(twice, keep, np.array([5, WALL + 5]), features).all()
    assert clicked_groups(twice, keep, np.zeros(0, np.int64), features).all()


def test_convex_hull_spans_gaps_and_leaves_out_small_pieces() -> None:
    mask = np.zeros((30, 40), bool)
    mask[2:20, 2:5] = mask[2:20, 20:23] = mask[28, 38] = True
    hull = _convex_hull(mask, 0.1)
    assert hull[2:20, 2:23].all() and hull.sum() == 18 * 21
    assert _convex_hull(mask, 0.0)[20:25].any() and not _convex_hull(np.zeros((4, 4), bool), 0.1).any()
