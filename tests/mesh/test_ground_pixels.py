# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

import numpy as np
from support.analytic import ball, camera, ring

from mgf_engine.mesh.ground_pixels import ground_pixels


def test_ground_pixels_are_those_of_the_nearest_view_that_a_vertex_faces():
    mesh = ball(0.5, 4)
    near, far = camera((3.0, 0, 0)), camera((-6.0, 0, 0))
    size = ground_pixels(mesh, [near, far])
    front, behind = mesh.vertices[:, 0] > 0.3, mesh.vertices[:, 0] < -0.3
    for side, view in ((front, near), (behind, far)):
        distance = np.linalg.norm(mesh.vertices[side] - view.centre, axis=1)
        assert np.allclose(size[side], distance / view.fx, rtol=1e-5)
    assert (ground_pixels(mesh, []) == 0).all() and np.isfinite(ground_pixels(mesh, ring(2))).all()


def test_ground_pixels_are_not_those_of_a_near_view_that_looks_away():
    mesh = ball(0.5, 4)
    near, far = camera((1.2, 0, 0), target=(5.0, 0, 0)), camera((3.0, 0, 0))
    front = mesh.vertices[:, 0] > 0.3
    distance = np.linalg.norm(mesh.vertices[front] - far.centre, axis=1)
    assert np.allclose(ground_pixels(mesh, [near, far])[front], distance / far.fx, rtol=1e-5)
