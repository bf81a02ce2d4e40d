# SPDX-License-Identifier: GPL-3.0-or-later
"""The level set between solid and free corners of tetrahedra, and which of its faces mean something."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from mgf_engine.errors import BadInput
from mgf_engine.mesh.isosurface import FREE, SOLID
from mgf_engine.mesh.level_set import Reporting, extract_level_set
from mgf_engine.mesh.tetra_blocks import TetraBlocks
from mgf_engine.mesh.tetrahedra import TetraPoints

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
ONE = np.array([[0, 1, 2, 3]], np.int32)


class HalfSpace:
    """Solid where the sum of the coordinates is below a level."""

    def __init__(self, level: float) -> None:
        self.level = level

    def classify(self, points: np.ndarray, progress: Callable[[float], None] = lambda share: None) -> np.ndarray:
        progress(1.0)
        return np.where(points.sum(1) < self.level, SOLID, FREE).astype(np.uint8)

    def signed(self, points: np.ndarray, progress: Callable[[float], None] = lambda share: None) -> np.ndarray:
        progress(1.0)
        return np.clip(points.sum(1) - self.level, -1, 1).astype(np.float32)


def sites(points: np.ndarray, extent: float) -> TetraBlocks:
    return TetraBlocks(TetraPoints(points, np.full(len(points), extent)), [np.arange(len(points))])


def one(number: int) -> np.ndarray:
    """The tetrahedra of the only block."""
    assert number == 0
    return ONE


def test_a_corner_is_cut_off_at_the_level() -> None:
    shares: list[float] = []
    mesh = extract_level_set(sites(CORNERS, 1.0), one, HalfSpace(0.3), 8, Reporting(shares.append))
    assert mesh.faces.shape == (1, 3)
    np.testing.assert_allclose(mesh.vertices.sum(1), 0.3, atol=0.03)
    assert shares == sorted(shares) and shares[0] > 0 and shares[-1] <= 1


@pytest.mark.parametrize(("far", "faces"), [(1.0, 1), (3.9, 1), (4.1, 0), (9.0, 0)])
def test_edges_longer_than_both_gaussians_reach_carry_no_face(far: float, faces: int) -> None:
    points = CORNERS * (far, 1, 1)
    assert len(extract_level_set(sites(points, 2.0), one, HalfSpace(0.3), 8).faces) == faces


@pytest.mark.parametrize("level", [-1.0, 9.0])
def test_what_is_all_free_or_all_solid_has_no_surface(level: float) -> None:
    with pytest.raises(BadInput, match="no surface"):
        extract_level_set(sites(CORNERS, 1.0), one, HalfSpace(level), 8)
