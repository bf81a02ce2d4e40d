# SPDX-License-Identifier: GPL-3.0-or-later
"""Clusters of faces, and which of them may show in a part of a picture."""

from __future__ import annotations

import numpy as np
from support.analytic import camera

from mgf_engine.mesh.face_clusters import CLUSTER_SIZE, FaceClusters

#: Looks along y from 4 away: x = -1, 0, 1 fall on u = 35, 80, 125 of 160.
VIEW = camera((0.0, -4.0, 0.0))


def patches(*places: float) -> tuple[np.ndarray, np.ndarray]:
    """A cluster of equal small triangles at each place along x; vertices [N, 3], faces [F, 3]."""
    corners = np.array([[-0.1, 0, -0.1], [0.1, 0, -0.1], [0, 0, 0.1]])
    vertices = np.concatenate([corners + np.array([x, 0, 0]) for x in places])
    faces = np.repeat(np.arange(len(vertices), dtype=np.int32).reshape(-1, 3), CLUSTER_SIZE, axis=0)
    return vertices, faces


def test_the_last_cluster_repeats_its_last_face() -> None:
    vertices, faces = patches(-1.0, 1.0)
    clusters = FaceClusters.of(vertices, faces[:-5])
    assert clusters.faces.shape == (2, CLUSTER_SIZE, 3) and (clusters.faces[1, -6:] == faces[-6]).all()
    assert clusters.boxes.shape == (16, 3)
    assert np.allclose(clusters.boxes[:8].min(0), [-1.1, 0, -0.1]) and np.allclose(
        clusters.boxes[:8].max(0), [-0.9, 0, 0.1]
    )


def test_only_clusters_over_wanted_pixels_are_found() -> None:
    clusters = FaceClusters.of(*patches(-1.0, 0.0, 1.0))
    wanted = np.zeros((VIEW.height, VIEW.width), bool)
    assert clusters.touching(VIEW, wanted).tolist() == []
    wanted[64, 35] = True
    assert clusters.touching(VIEW, wanted).tolist() == [0]
    wanted[64, 125] = True
    assert clusters.touching(VIEW, wanted).tolist() == [0, 2]


def test_a_cluster_behind_the_camera_shows_nowhere_and_one_around_it_may_show_anywhere() -> None:
    everywhere, corner = np.ones((2, VIEW.height, VIEW.width), bool)
    corner[:, 1:], corner[1:] = False, False
    vertices, faces = patches(0.0)
    assert FaceClusters.of(vertices - np.array([0, 8, 0]), faces).touching(VIEW, everywhere).tolist() == []
    around = np.array([[-0.1, -5, 0], [0.1, -3, 0], [0, -4, 0.1]])
    assert FaceClusters.of(around, faces).touching(VIEW, corner).tolist() == [0]
