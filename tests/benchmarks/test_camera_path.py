# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras of the synthetic flights."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.buildings import BUILDINGS
from benchmarks.camera_path import Ring, look_at, plan
from benchmarks.catalogue import SCENES, scene_spec
from benchmarks.surroundings import surroundings
from mgf_engine.errors import BadInput

EXTENT = np.array([[-12.0, -6.0], [12.0, 6.0]])


def test_look_at_puts_the_target_in_the_middle_with_the_sky_up() -> None:
    eye, target = np.array([20.0, -30.0, 12.0]), np.array([1.0, 2.0, 5.0])
    rotation, translation = look_at(eye, target)
    assert np.allclose(rotation @ rotation.T, np.eye(3)) and np.linalg.det(rotation) == pytest.approx(1)
    seen = rotation @ target + translation
    assert seen[:2] == pytest.approx([0, 0], abs=1e-9) and seen[2] == pytest.approx(np.linalg.norm(target - eye))
    above = rotation @ (target + np.array([0.0, 0.0, 1.0])) + translation
    assert above[1] < 0  # y points down


def test_straight_down_works() -> None:
    rotation, translation = look_at(np.array([3.0, 4.0, 50.0]), np.array([3.0, 4.0, 0.0]))
    assert np.isfinite(rotation).all()
    assert (rotation @ [3, 4, 0] + translation) == pytest.approx([0, 0, 50])


def test_a_ring_within_a_court_looks_across_it() -> None:
    shots = plan(12, EXTENT, (Ring(1.0, 2.0, -3.0, 4.0),), None, 0.0, 0.0, np.random.default_rng(0))
    eyes = np.array([-s.rotation.T @ s.translation for s in shots])
    assert (np.abs(eyes[:, :2]) < EXTENT[1]).all()
    assert all(s.rotation[2, :2] @ eye[:2] < 0 for s, eye in zip(shots, eyes, strict=True))


def test_plan_keeps_its_count_heights_and_distance() -> None:
    rings = (Ring(0.5, 10.0, 25.0), Ring(0.3, 24.0, 20.0))
    nadir = {"height": 50.0, "half_x": 20.0, "half_y": 10.0}
    shots = plan(40, EXTENT, rings, nadir, 0.0, 0.0, np.random.default_rng(0))
    assert len(shots) == 40 and len({s.name for s in shots}) == 40
    eyes = np.array([-s.rotation.T @ s.translation for s in shots])
    low = eyes[:20]
    assert low[:, 2] == pytest.approx(10.0, rel=0.1)
    outside = np.maximum(np.abs(low[:, :2]) - [12, 6], 0)
    assert np.linalg.norm(outside, axis=1).min() > 12 and np.linalg.norm(outside, axis=1).max() < 32
    assert (np.array([s.rotation[2, 2] for s in shots[32:]]) < -0.95).all()


def test_the_same_seed_gives_the_same_flight_and_surroundings() -> None:
    def make(seed: int) -> np.ndarray:
        rng = np.random.default_rng(seed)
        shots = plan(10, EXTENT, (Ring(1.0, 10, 25),), None, 0.0, 0.3, rng)
        eyes = np.array([-s.rotation.T @ s.translation for s in shots])
        around = surroundings(EXTENT, eyes, rng, 2, 1, 1, 1, "brick")
        return np.concatenate([eyes.ravel(), *(p.vertices.ravel() for p in around)])

    assert np.array_equal(make(3), make(3))
    assert not np.array_equal(make(3)[:30], make(4)[:30])


def test_nothing_stands_where_a_camera_is() -> None:
    rng = np.random.default_rng(0)
    shots = plan(20, EXTENT, (Ring(1.0, 8, 24),), None, 0.0, 0.0, rng)
    eyes = np.array([-s.rotation.T @ s.translation for s in shots])
    around = surroundings(EXTENT, eyes, rng, 10, 0, 4, 0, "brick")
    for part in around:
        assert not part.building
        if part.name.startswith("ground"):
            continue
        low, high = part.vertices.min(0), part.vertices.max(0)
        assert not ((eyes > low) & (eyes < high)).all(axis=1).any()


def test_every_named_scene_uses_known_parts() -> None:
    for spec in SCENES.values():
        assert spec.building in BUILDINGS
        assert sum(ring.share for ring in spec.rings) == pytest.approx(1.0) or spec.nadir is not None
    assert scene_spec("demo", photos=5, width=None).photos == 5
    assert (SCENES["steel_frame_hall"].photos, SCENES["brick_ensemble"].photos) == (146, 147)
    with pytest.raises(BadInput, match="There is no scene 'nowhere'"):
        scene_spec("nowhere")
