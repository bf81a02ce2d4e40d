# SPDX-License-Identifier: GPL-3.0-or-later
"""Similarities between points: the closed form, the largest consistent set, and residuals over their accuracies."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mgf_engine.georef.similarity import (
    LINE,
    Direction,
    find_inliers,
    matrix_of,
    refine_similarity,
    straightness,
    transform_points,
    umeyama,
)

TRUE = matrix_of(2.5, Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix(), np.array([10.0, -4.0, 600_000.0]))


@pytest.fixture
def source() -> np.ndarray:
    return np.random.default_rng(0).normal(size=(12, 3))


def test_the_closed_form_finds_the_similarity(source: np.ndarray) -> None:
    np.testing.assert_allclose(umeyama(source, transform_points(TRUE, source)), TRUE, atol=1e-8)


def test_a_mirrored_target_gives_a_rotation(source: np.ndarray) -> None:
    matrix = umeyama(source, source * (1, 1, -1))
    assert np.linalg.det(matrix[:3, :3]) > 0


def test_points_without_weight_do_not_count(source: np.ndarray) -> None:
    target, weights = transform_points(TRUE, source), np.ones(len(source))
    target[3] += 50
    weights[3] = 0
    np.testing.assert_allclose(umeyama(source, target, weights), TRUE, atol=1e-8)


def test_straightness_of_a_line_a_point_and_a_cloud() -> None:
    line = np.outer(np.arange(5.0), [1.0, 2.0, 3.0])
    assert straightness(line) < LINE and straightness(np.ones((4, 3))) == 0.0
    assert straightness(np.eye(3)) == pytest.approx(1.0)
    assert straightness(np.array([[0.0, 0, 0], [4, 0, 0], [0, 1, 0]])) == pytest.approx(0.22, abs=0.02)


def test_consensus_leaves_out_what_one_similarity_does_not_explain(source: np.ndarray) -> None:
    target = transform_points(TRUE, source)
    target[[2, 7, 8]] += [[30.0, 0, 0], [0, 9.0, 0], [0, 0, -4.0]]
    kept = find_inliers(source, target, np.full(len(source), 0.5))
    assert np.flatnonzero(~kept).tolist() == [2, 7, 8]


def test_consensus_of_points_on_a_line_is_empty() -> None:
    line = np.outer(np.arange(6.0), [1.0, 0.0, 0.0])
    assert not find_inliers(line, line, np.ones(6)).any()


def test_adjusting_trusts_accurate_coordinates_and_up(source: np.ndarray) -> None:
    target, sd = transform_points(TRUE, source), np.full((len(source), 3), 0.01)
    target[0, 2] += 3.0
    sd[0, 2] = 1e3
    near = matrix_of(2.4, Rotation.from_rotvec([0.31, -1.1, 0.68]).as_matrix(), TRUE[:3, 3] + 0.3)
    np.testing.assert_allclose(refine_similarity(near, source, target, sd), TRUE, atol=1e-5)
    up = Direction(TRUE[:3, :3].T @ [0, 0, 1.0] / 2.5, 1e-6)  # what is up, as the source sees it
    line = np.outer(np.arange(5.0), [1.0, 0.3, 0.1])
    turned = refine_similarity(TRUE, line, transform_points(TRUE, line), np.full((5, 3), 0.01), up)
    assert turned[2, :3] @ up.source == pytest.approx(2.5, rel=1e-6)
