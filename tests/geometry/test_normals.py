# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

import numpy as np
from support.analytic import ball

from mgf_engine.geometry.normals import principal_normals, unit_vectors, vertex_normals


def test_vectors_of_no_length_stay_zero() -> None:
    found = unit_vectors(np.array([[3.0, 0, 4.0], [0, 0, 0]]))
    np.testing.assert_allclose(found, [[0.6, 0, 0.8], [0, 0, 0]])


def test_normals_of_points_on_a_plane_are_its_normal() -> None:
    rng = np.random.default_rng(0)
    normal = unit_vectors(np.array([1.0, -2.0, 0.5]))
    points = rng.normal(size=(40, 3))
    points -= (points @ normal)[:, None] * normal
    neighbours = np.stack([rng.permutation(40)[:8] for _ in range(40)])
    found = principal_normals(points, neighbours)
    assert found.shape == (40, 3)
    np.testing.assert_allclose(np.abs(found @ normal), 1.0, atol=1e-12)


def test_vertex_normals_of_a_sphere() -> None:
    mesh = ball(subdivisions=3)
    assert np.abs(vertex_normals(mesh) - mesh.vertices).max() < 0.02
