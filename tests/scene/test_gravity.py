# SPDX-License-Identifier: GPL-3.0-or-later
"""The direction up: from the way cameras are held, and from edges that are vertical in space."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.small_scene import grid, photos, tilted

from mgf_engine.native.library import set_threads
from mgf_engine.scene import gravity
from mgf_engine.scene.gravity import common_direction, find_up, rough_up, turn_up, up_from_cameras, up_of_tilted_view
from mgf_engine.scene.validation import surround_angle

UP = np.array([0.0, 0.0, 1.0])


@pytest.mark.parametrize("degrees", [0.0, 3.0])
def test_photos_straight_down_tell_up_by_where_they_look(degrees: float) -> None:
    up = up_from_cameras(photos(grid(6, 5), tilted(30, degrees)).views)
    assert up @ [0, 0, 1] > 0.999


def test_a_row_of_photos_of_a_front_is_upright() -> None:
    front = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # looks along y, z up
    row = np.c_[np.arange(12), np.zeros(12), 0.05 * (np.arange(12) % 3)]
    assert up_from_cameras(photos(row, [front] * 12).views) @ [0, 0, 1] > 0.999


def kite(down: float, heading: float, roll: float) -> tuple:
    """Return photos of a kite or drone that looks steeply down, ``down`` degrees below the horizon in the mean, mostly
    in one direction: with standard deviations of ``heading`` and ``roll`` degrees."""
    rng = np.random.default_rng(2)
    places, rotations = [], []
    for _ in range(28):
        tilt, turn, lean = np.radians([rng.normal(down, 12), rng.normal(0, heading), rng.normal(0, roll)])
        forward = np.array([np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), -np.sin(tilt)])
        right = np.array([np.sin(turn), -np.cos(turn), 0])
        below = np.cross(forward, right)
        x, y = np.cos(lean) * right + np.sin(lean) * below, np.cos(lean) * below - np.sin(lean) * right
        places.append(rng.normal(0, 1, 3) * [9, 5, 2] + [0, 0, 30])
        rotations.append(np.stack([x, y, forward]))
    return photos(np.array(places), rotations).views


@pytest.mark.parametrize("heading", [30.0, 60.0, 300.0])
def test_steep_photos_from_above_tell_up_by_their_level_axes(heading: float) -> None:
    """What is up in them is where the camera headed, 65 degrees from up."""
    up = up_from_cameras(kite(65, heading, 6))
    assert np.degrees(np.arccos(up @ [0, 0, 1])) < 5


def test_upright_and_sideways_photos_of_a_front_are_not_from_above() -> None:
    """Half of them lie on their side, and nothing says so."""
    rotations = [np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])] * 6
    row = np.c_[np.arange(12), np.zeros(12), 0.05 * (np.arange(12) % 3)]
    assert abs(up_from_cameras(photos(row, rotations).views) @ [0, 1, 0]) < 0.1


def test_a_front_flown_in_rows_is_upright_by_the_gimbal() -> None:
    """Without tags a grid of photos that all look one way is taken for one that looks down."""
    front = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # looks along y, z up
    rows = np.array([[x, 0.0, z] for z in range(5) for x in range(6)])
    scene = photos(rows, [front] * 30)
    assert abs(rough_up(scene.views).vector @ [0, 1, 0]) > 0.99
    tagged = tuple(replace(v, gravity=(0.0, -1.0, 0.0)) for v in scene.views[:10]) + scene.views[10:]
    found = rough_up(tagged)
    assert found.method == "tags" and found.vector @ [0, 0, 1] > 0.999


def ring(down: float, lean: float = 0.0) -> tuple:
    """Return twelve cameras around the origin that look ``down`` degrees below the horizon, every other one rolled by
    ``lean`` degrees."""
    places, rotations = [], []
    for number, angle in enumerate(np.linspace(0, 2 * np.pi, 12, endpoint=False)):
        level = np.cos(np.radians(down))
        forward = -np.array([level * np.cos(angle), level * np.sin(angle), np.sin(np.radians(down))])
        right = np.cross(forward, [0, 0, 1.0]) / level
        c, s = np.cos(np.radians(lean * (number % 2))), np.sin(np.radians(lean * (number % 2)))
        places.append(-9 * forward)
        rotations.append(
            np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ np.stack([right, np.cross(forward, right), forward])
        )
    return photos(np.array(places), rotations).views


def test_a_photo_that_looks_down_takes_up_from_all_cameras() -> None:
    views = ring(35.0)
    assert up_of_tilted_view(views[0], views, 20.0, 10.0) @ [0, 0, 1] > 0.999
    level = ring(5.0)
    assert up_of_tilted_view(views[0], [views[0], *level], 20.0, 10.0) @ [0, 0, 1] > 0.999


def test_a_photo_keeps_its_own_up_where_it_is_nearly_level_or_the_cameras_know_no_better() -> None:
    level, steep = ring(12.0), ring(35.0)
    assert up_of_tilted_view(level[0], level, 20.0, 10.0) is None
    rolled = ring(35.0, lean=90.0)
    assert up_of_tilted_view(rolled[0], rolled, 20.0, 10.0) is None, "half of the cameras were held upright"
    assert up_of_tilted_view(steep[0], steep[:1], 20.0, 10.0) is None, "one camera alone"
    nadir = photos(grid(6, 5), tilted(30, 0.0)).views
    assert up_of_tilted_view(nadir[0], nadir, 20.0, 10.0) is None, "all look straight down"


@pytest.mark.parametrize(("orientation", "turn"), [(1, 0), (3, 2), (6, 1), (8, 3)])
def test_cameras_that_were_turned_tell_up_by_the_orientation_of_their_photos(orientation: int, turn: int) -> None:
    """Phones store photos as the sensor saw them: held upright, the building lies on its side in the pixels."""
    quarter = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])  # the camera, turned against the clock seen from behind
    ring, rotations = [], []
    for angle in np.arange(0, 2 * np.pi, 0.5):
        forward = -np.array([np.cos(angle), np.sin(angle), 0.1])
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1.0]) / np.linalg.norm(np.cross(forward, [0, 0, 1.0]))
        upright = np.stack([right, np.cross(forward, right), forward])
        ring.append(-9 * forward)
        rotations.append(np.linalg.matrix_power(quarter, turn) @ upright)
    scene = photos(np.array(ring), rotations)
    scene = replace(scene, views=tuple(replace(v, held=orientation) for v in scene.views))
    assert up_from_cameras(scene.views) @ [0, 0, 1] > 0.999
    assert surround_angle(replace(scene, points=np.zeros((1, 3)))) > 300


@pytest.mark.parametrize("lean", [0.0, 3.0])
def test_vertical_edges_tell_up_better_than_the_rough_direction(lean: float) -> None:
    """Planes through a camera and a vertical edge hold the direction up; half of the planes are of other edges."""
    rng = np.random.default_rng(0)
    angle = rng.uniform(0, 2 * np.pi, 200)
    vertical = np.stack([np.cos(angle), np.sin(angle), rng.normal(0, 1e-3, 200)], 1)
    others = rng.normal(size=(200, 3))
    normals = np.concatenate([vertical, others])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    rough = np.array([np.sin(np.radians(lean)), 0.0, np.cos(np.radians(lean))])
    near = np.abs(normals @ rough) < np.sin(np.radians(10))
    found = common_direction(normals[near], np.ones(int(near.sum())), rough)
    assert np.degrees(np.arccos(min(found @ [0, 0, 1], 1.0))) < 0.1


def test_edges_are_looked_for_in_several_photos_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    both = threading.Barrier(2, timeout=20)

    def edge_planes(*given: object) -> tuple[np.ndarray, np.ndarray]:
        both.wait()
        return np.zeros((0, 3)), np.zeros(0)

    monkeypatch.setattr(gravity, "edge_planes", edge_planes)
    monkeypatch.setattr(gravity.Scene, "photo", lambda scene, index: None)
    set_threads(2)
    try:
        assert find_up(photos(grid(2, 1), tilted(2, 0.0))).method == "cameras"
    finally:
        set_threads(0)


@pytest.mark.parametrize("seed", range(5))
def test_the_turn_is_the_smallest_that_takes_up_to_z(seed: int) -> None:
    up = np.random.default_rng(seed).normal(size=3)
    up /= np.linalg.norm(up)
    turn = turn_up(up)
    np.testing.assert_allclose(turn @ up, UP, atol=1e-12)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert Rotation.from_matrix(turn).magnitude() == pytest.approx(np.arccos(up[2]), abs=1e-8)


def test_upside_down_is_turned_over() -> None:
    turn = turn_up(-UP)
    np.testing.assert_allclose(turn @ -UP, UP, atol=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1.0)
    np.testing.assert_array_equal(turn_up(UP), np.eye(3))
