# SPDX-License-Identifier: GPL-3.0-or-later
"""A mesh that was moved, turned and scaled is laid back onto its truth."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from mgf_engine.evaluation.align import align_points, align_to
from mgf_engine.evaluation.surfaces import Surface


def surface(mesh: trimesh.Trimesh, matrix: np.ndarray | None = None) -> Surface:
    vertices = np.asarray(mesh.vertices)
    return Surface(vertices if matrix is None else vertices @ matrix[:3, :3].T + matrix[:3, 3], mesh.faces)


def similarity(degrees: float, scale: float, shift: tuple[float, float, float]) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = scale * Rotation.from_rotvec(np.radians(degrees) * np.array([0.6, 0.0, 0.8])).as_matrix()
    matrix[:3, 3] = shift
    return matrix


#: No two sides alike, so that only one way back fits.
HOUSE = trimesh.util.concatenate([trimesh.creation.box((4, 3, 2)), trimesh.creation.icosphere(2, 0.7)])
HOUSE.vertices[len(trimesh.creation.box().vertices) :] += (1.0, 0.5, 1.2)


@pytest.mark.parametrize(("scale", "adjusted"), [(1.0, False), (1.05, True)])
def test_the_way_back_is_found(scale: float, adjusted: bool) -> None:
    moved = similarity(4.0, scale, (0.10, -0.05, 0.08))
    back = align_to(surface(HOUSE, moved), surface(HOUSE), adjusted, count=4000)
    assert np.abs(back @ moved - np.eye(4)).max() < 1e-4


def test_scale_stays_where_it_may_not_change() -> None:
    back = align_to(surface(HOUSE, similarity(0.0, 1.05, (0, 0, 0))), surface(HOUSE), False, count=4000)
    assert np.linalg.det(back[:3, :3]) == pytest.approx(1.0, abs=1e-9)


def test_points_without_a_counterpart_pull_little() -> None:
    moved = similarity(3.0, 1.0, (0.05, 0.05, 0.0))
    truth = surface(HOUSE)
    points = surface(HOUSE, moved).sample(3000, np.random.default_rng(0))[0]
    trees = np.random.default_rng(1).uniform((3, -2, -1), (5, 2, 1), (300, 3))
    back = align_points(np.concatenate([points, trees]), truth, False)
    assert np.abs(back @ moved - np.eye(4)).max() < 0.02
