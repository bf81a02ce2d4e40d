# SPDX-License-Identifier: GPL-3.0-or-later
"""Scores of masks against masks of known faults."""

import numpy as np
import pytest

from benchmarks.mask_scores import edge_bias, score_photo


def box(low: int, high: int) -> np.ndarray:
    labels = np.zeros((80, 80), np.uint8)
    labels[low:high, low:high] = 1
    return labels


def test_the_truth_scores_full():
    truth = box(20, 60)
    elements = truth.copy()
    elements[30:40, 30:40] = 2
    score = score_photo(elements, truth, elements)
    assert score.iou == 1.0 and score.element_overlap == 1.0
    assert score.element_boundaries == pytest.approx(1.0) and abs(score.edge) < 0.1


@pytest.mark.parametrize("grown", [-2, 2])
def test_edge_has_the_sign_and_size_of_the_fault(grown: int):
    valid = np.ones((80, 80), bool)
    assert edge_bias(box(20 - grown, 60 + grown) > 0, box(20, 60) > 0, valid) == pytest.approx(grown, abs=0.3)


def test_occluders_do_not_count_and_missing_buildings_do():
    truth = box(20, 60)
    hidden = truth.copy()
    hidden[20:40] = np.where(truth[20:40] > 0, 255, 0)
    half = truth.copy()
    half[20:40] = 0
    assert score_photo(half, hidden, hidden).iou == 1.0
    assert score_photo(half, hidden, hidden).occluded == 0
    assert score_photo(truth, hidden, hidden).occluded == pytest.approx(1.0)  # as large as what is seen
    assert score_photo(half, truth, truth).iou == pytest.approx(0.5)
    assert np.isnan(score_photo(box(0, 0), box(0, 0), box(0, 0)).iou)
