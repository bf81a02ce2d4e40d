# SPDX-License-Identifier: GPL-3.0-or-later
"""The normalised frame: centred, scaled, exactly invertible, precise far from the origin."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.errors import BadInput
from mgf_engine.model.scene import Similarity
from mgf_engine.scene.normalise import CAMERA_DISTANCE, normalise, normalise_pose, rotation_of, weighted_median


def ring(offset: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A building of points at ``offset``, a few far points, cameras around it."""
    random = np.random.default_rng(1)
    points = np.concatenate([random.normal(size=(500, 3)), random.normal(size=(50, 3)) * 300 + (400, 0, 0)]) * size
    angle = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    centres = np.stack([12 * np.cos(angle), 12 * np.sin(angle), np.full(20, 2.0)], 1) * size
    return points + offset, np.full(len(points), 3), centres + offset


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e4])
@pytest.mark.parametrize("offset", [np.zeros(3), np.array([4.6e5, 5.4e6, 120.0])])
def test_centre_scale_and_inverse(offset: np.ndarray, size: float) -> None:
    points, seen, centres = ring(offset, size)
    similarity = normalise(points, seen, centres)
    normalised = similarity.apply(points)
    assert np.abs(np.median(normalised[:500], axis=0)).max() < 0.3
    assert np.median(np.linalg.norm(similarity.apply(centres), axis=1)) == pytest.approx(CAMERA_DISTANCE, rel=1e-6)
    # Coordinates of 5e6 have steps of 1e-9; a few of them may be lost.
    assert np.abs(similarity.invert(normalised) - points).max() <= 1e-8 * max(1.0, size)


def test_map_coordinates_keep_pixels() -> None:
    """The same scene at the origin and in UTM: projections differ by less than a thousandth of a pixel."""
    near, far = np.zeros(3), np.array([4.6e5, 5.4e6, 120.0])
    pixels = []
    for offset in (near, far):
        points, seen, centres = ring(offset, 1.0)
        similarity = normalise(points, seen, centres)
        rotation = rotation_of(np.array([0.5, 0.5, -0.5, 0.5]))
        r, t = normalise_pose(rotation, -rotation @ centres[3], similarity)
        local = similarity.apply(points) @ r.T + t
        pixels.append(1000 * local[:, :2] / local[:, 2:])
    assert np.abs(pixels[0] - pixels[1]).max() < 1e-3


def test_poses_see_the_same() -> None:
    random = np.random.default_rng(2)
    similarity = Similarity(0.3, rotation_of(random.normal(size=4)), random.normal(size=3))
    rotation, translation = rotation_of(random.normal(size=4)), random.normal(size=3)
    points = random.normal(size=(20, 3))
    r, t = normalise_pose(rotation, translation, similarity)
    assert np.allclose(similarity.apply(points) @ r.T + t, 0.3 * (points @ rotation.T + translation))
    assert np.allclose(r @ r.T, np.eye(3))


def test_points_that_many_cameras_see_count_more() -> None:
    assert weighted_median(np.array([0.0, 1.0, 2.0]), np.array([1, 1, 1])) == 1.0
    assert weighted_median(np.array([2.0, 0.0, 1.0]), np.array([10, 1, 1])) == 2.0
    points = np.concatenate([np.zeros((50, 3)), np.full((100, 3), 40.0)])
    centres = np.array([[5.0, 0, 0], [0, 5.0, 0], [-5.0, 0, 0]])
    seen = np.array([10] * 50 + [2] * 100)
    assert np.allclose(normalise(points, seen, centres).invert(np.zeros(3)), 0.0)


def test_cameras_in_one_spot_with_the_points_are_refused() -> None:
    with pytest.raises(BadInput, match="All cameras stand"):
        normalise(np.ones((5, 3)), np.ones(5, np.int64), np.ones((3, 3)))


def test_quaternions() -> None:
    half = np.sqrt(0.5)
    assert np.allclose(rotation_of(3 * np.array([half, 0, 0, half])), [[0, -1, 0], [1, 0, 0], [0, 0, 1]])
