# SPDX-License-Identifier: GPL-3.0-or-later
"""The report tells how much of the mesh is confirmed by photos, and what would confirm more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mgf_engine.evaluation.advice import JobFacts, advice
from mgf_engine.evaluation.confidence import ConfidenceShares, colored_by_confidence, measure_confidence
from mgf_engine.model.mesh import Mesh


def four_squares(confidence: list[float], views: list[int]) -> Mesh:
    """Four separate unit squares, each with a confidence and a number of photos of its own."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    vertices = np.concatenate([corners + np.array([2.0 * k, 0, 0]) for k in range(4)])
    faces = np.concatenate([np.array([[0, 1, 2], [0, 2, 3]]) + 4 * k for k in range(4)]).astype(np.int32)
    values = {"confidence": np.repeat(confidence, 4).astype(np.float32), "views": np.repeat(views, 4).astype(np.uint8)}
    return Mesh(vertices, faces, np.zeros((16, 3), np.uint8), values)


def test_the_area_is_shared_out_by_what_photos_confirm() -> None:
    shares = measure_confidence(four_squares([0.9, 0.6, 0.3, 0.0], [5, 3, 1, 0]))
    assert shares == ConfidenceShares(*[pytest.approx(0.25)] * 4)
    scarce = measure_confidence(four_squares([0.9, 0.9, 0.9, 0.9], [5, 5, 5, 0]))
    assert scarce is not None and scarce.unseen == pytest.approx(0.25) and scarce.agreed == pytest.approx(0.75)


def test_a_mesh_without_confidence_has_no_shares() -> None:
    mesh = four_squares([1, 1, 1, 1], [3, 3, 3, 3])
    assert measure_confidence(replace(mesh, values={})) is None
    assert measure_confidence(replace(mesh, vertices=np.zeros_like(mesh.vertices))) is None


def test_what_is_confirmed_is_yellow_and_what_is_not_violet() -> None:
    colors = colored_by_confidence(four_squares([1, 0.5, 0.5, 0], [3, 3, 3, 0])).colors.astype(int)
    (red, green, blue), (dark_red, dark_green, dark_blue) = colors[0], colors[-1]
    assert red > 200 and green > 200 and blue < 100
    assert dark_blue > dark_green and dark_red > dark_green


GOOD = JobFacts(ConfidenceShares(0.95, 0.05, 0, 0), 1000, 1000, (), trained=True)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            {"confidence": ConfidenceShares(0.5, 0.05, 0.25, 0.2)},
            "45% of the surface is shown by fewer than three photos",
        ),
        ({"confidence": ConfidenceShares(0.6, 0.4, 0, 0)}, "On 40% of the surface"),
        ({"weak_masks": tuple("abcdefg")}, "not used: a, b, c, d, e and 2 more."),
        ({"photo_side": 6000}, "--resolution 2000"),
        ({"photo_side": 1500}, "--resolution 1500"),
        ({"trained": False}, "--preset standard"),
    ],
)
def test_advice_follows_from_the_figures(change, said) -> None:
    told = advice(replace(GOOD, **change))
    assert len(told) == 1 and said in told[0]


def test_there_is_no_advice_where_nothing_is_wanting() -> None:
    assert advice(GOOD) == advice(replace(GOOD, confidence=None)) == []
