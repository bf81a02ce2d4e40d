# SPDX-License-Identifier: GPL-3.0-or-later
"""How much of the area of a mesh photos confirm, and how far."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mgf_engine.mesh.confidence import ConfidenceShares, measure_confidence
from mgf_engine.model.mesh import Mesh


def four_squares(confidence: list[float], views: list[int]) -> Mesh:
    """Four separate unit squares, each with a confidence and a number of photos of its own."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    vertices = np.concatenate([corners + np.array([2.0 * k, 0, 0]) for k in range(4)])
    faces = np.concatenate([np.array([[0, 1, 2], [0, 2, 3]]) + 4 * k for k in range(4)]).astype(np.int32)
    values = {"confidence": np.repeat(confidence, 4).astype(np.float32), "views": np.repeat(views, 4).astype(np.uint8)}
    return Mesh(vertices, faces, np.zeros((16, 3), np.uint8), values)


def test_a_mesh_without_confidence_has_none() -> None:
    mesh = four_squares([1, 1, 1, 1], [3, 3, 3, 3])
    assert measure_confidence(replace(mesh, values={})) is None
    assert measure_confidence(replace(mesh, vertices=np.zeros_like(mesh.vertices))) is None


def test_the_area_is_shared_out_by_what_photos_confirm() -> None:
    found = measure_confidence(four_squares([0.9, 0.6, 0.3, 0.0], [5, 3, 1, 0]))
    assert found is not None and found.shares == ConfidenceShares(*[pytest.approx(0.25)] * 4)
    scarce = measure_confidence(four_squares([0.9, 0.9, 0.9, 0.9], [5, 5, 5, 0]))
    assert scarce is not None
    assert scarce.shares == ConfidenceShares(pytest.approx(0.75), 0, 0, pytest.approx(0.25))


def test_mean_and_low_share_count_by_area_not_by_vertex() -> None:
    mesh = four_squares([0.8, 0.6, 0.4, 0.0], [5, 3, 1, 0])
    mesh.vertices[:4] *= np.sqrt(7)  # 7 of 10 units of area
    found = measure_confidence(mesh, low=0.6)
    assert found is not None
    assert found.mean == pytest.approx(0.7 * 0.8 + 0.1 * (0.6 + 0.4 + 0.0), abs=1e-6)  # float32
    assert found.low == pytest.approx(0.2)  # 0.6 itself is not low
