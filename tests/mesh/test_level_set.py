# SPDX-License-Identifier: GPL-3.0-or-later
"""The level set between solid and free corners of tetrahedra, and which of its faces mean something."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from support.analytic import ball, ring, scene_of

from mgf_engine.errors import BadInput
from mgf_engine.mesh.isosurface import FREE, SOLID
from mgf_engine.mesh.level_set import Reporting, clean_level_set, extract_level_set
from mgf_engine.mesh.options import ExtractionOptions
from mgf_engine.mesh.tetra_blocks import TetraBlocks
from mgf_engine.mesh.tetrahedra import TetraPoints
from mgf_engine.mesh.trusted_views import TrustedViews
from mgf_engine.model.mesh import Mesh

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


def spanned(points: np.ndarray, extent: float) -> TetraBlocks:
    return TetraBlocks(TetraPoints(points, np.full(len(points), extent)), [np.arange(len(points))])


def one(number: int) -> np.ndarray:
    """The tetrahedra of the only block."""
    assert number == 0
    return ONE


def test_a_corner_is_cut_off_at_the_level() -> None:
    shares: list[float] = []
    mesh = extract_level_set(spanned(CORNERS, 1.0), one, HalfSpace(0.3), 8, Reporting(shares.append))
    assert mesh.faces.shape == (1, 3)
    np.testing.assert_allclose(mesh.vertices.sum(1), 0.3, atol=0.03)
    assert shares == sorted(shares) and shares[0] > 0 and shares[-1] <= 1


@pytest.mark.parametrize(("far", "faces"), [(1.0, 1), (3.9, 1), (4.1, 0), (9.0, 0)])
def test_edges_longer_than_both_gaussians_reach_carry_no_face(far: float, faces: int) -> None:
    points = CORNERS * (far, 1, 1)
    assert len(extract_level_set(spanned(points, 2.0), one, HalfSpace(0.3), 8).faces) == faces


@pytest.mark.parametrize("level", [-1.0, 9.0])
def test_what_is_all_free_or_all_solid_has_no_surface(level: float) -> None:
    with pytest.raises(BadInput, match="no surface"):
        extract_level_set(spanned(CORNERS, 1.0), one, HalfSpace(level), 8)


class Shown:
    """All solid; photos agree on what lies on or above the ball, hardly on what lies beside it."""

    def classify(self, points: np.ndarray) -> np.ndarray:
        return np.full(len(points), SOLID, np.uint8)

    def known(self, points: np.ndarray) -> dict[str, np.ndarray]:
        beside = (np.linalg.norm(points, axis=1) > 1.1) & (points[:, 2] < 1)
        return {
            "confirmed": np.ones(len(points), bool),
            "views": np.full(len(points), 3, np.uint8),
            "confidence": np.where(beside, 0.3, 0.6).astype(np.float32),
        }


def test_a_chimney_that_photos_confirm_stays_and_a_shred_beside_does_not() -> None:
    """None is connected with the rest: no photo shows the roof between."""
    small = ball(0.06, 2)
    shapes = [ball(), *(replace(small, vertices=small.vertices + place) for place in ((0, 0, 1.3), (1.3, 0, 0)))]
    starts = np.cumsum([0, *(len(shape.vertices) for shape in shapes)])
    mesh = Mesh(
        np.concatenate([shape.vertices for shape in shapes]),
        np.concatenate([shape.faces + start for shape, start in zip(shapes, starts, strict=False)]).astype(np.int32),
        np.concatenate([shape.colors for shape in shapes]),
    )
    scene, masks = scene_of(ring(), mesh)
    count = len(scene.views)
    trusted = TrustedViews(list(range(count)), list(scene.views), [], list(masks.labels), None)
    cleaned = clean_level_set(mesh, Shown(), trusted, ExtractionOptions(smoothing=0))  # type: ignore[arg-type]
    away = cleaned.vertices[np.linalg.norm(cleaned.vertices, axis=1) > 1.1]
    assert len(away) and (away[:, 2] > 1).all()
