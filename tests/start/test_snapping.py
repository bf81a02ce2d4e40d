# SPDX-License-Identifier: GPL-3.0-or-later
"""Points move onto planes nearby, into edges and corners, and no further."""

from __future__ import annotations

import numpy as np

from mgf_engine.start import reference
from mgf_engine.start.options import PlaneOptions
from mgf_engine.start.planes import LinePlanes
from mgf_engine.start.snapping import snap_to_planes


def test_points_snap_to_the_common_place_of_their_planes() -> None:
    planes = LinePlanes(np.array([[0, 0, 1.0, 0], [1.0, 0, 0, 0]]), [], np.ones(2))
    points = np.array([[0.005, 3, 0.004], [0.5, 3, 0.004], [0.5, 3, 0.5]])
    moved, on = snap_to_planes(points, planes, np.full(3, 0.01), PlaneOptions())
    np.testing.assert_allclose(moved, [[0, 3, 0], [0.5, 3, 0], [0.5, 3, 0.5]], atol=1e-12)
    np.testing.assert_array_equal(on, [[True, True], [True, False], [False, False]])


def test_points_among_many_planes_move_as_those_of_the_reference() -> None:
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(40, 3))
    normals[20:] = normals[:20] + rng.normal(scale=0.05, size=(20, 3))  # nearly parallel ones
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    planes = np.c_[normals, rng.normal(scale=0.05, size=40)]
    points, near = rng.uniform(-0.3, 0.3, (400, 3)), rng.choice([0.01, 0.05], 400)
    moved, _ = snap_to_planes(points, LinePlanes(planes, [], np.ones(40)), near, PlaneOptions())
    assert (np.linalg.norm(moved - points, axis=1) > 0).mean() > 0.5
    np.testing.assert_allclose(moved, reference.snap_to_planes(points, planes, near, PlaneOptions()), atol=1e-9)
    unmoved, on = snap_to_planes(points, LinePlanes(np.zeros((0, 4)), [], np.zeros(0)), near, PlaneOptions())
    np.testing.assert_array_equal(unmoved, points)
    assert on.shape == (400, 0)
