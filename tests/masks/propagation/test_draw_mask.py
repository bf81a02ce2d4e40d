# SPDX-License-Identifier: GPL-3.0-or-later
"""A mask that agrees badly with the hints is drawn a second time, and the better one is kept."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.masks.propagation.draw_mask import draw_mask
from mgf_engine.masks.propagation.propagation_options import PropagationOptions
from mgf_engine.masks.segmenters.base import Hints, Segment, agreement
from tests.support.segmenters import hints

OPTIONS = PropagationOptions(retry_below=0.9, retry_gain=0.02)
PHOTO = np.zeros((4, 6, 3), np.uint8)


class Scripted:
    """Answers each attempt with a mask of its own and a given score."""

    name = "scripted"

    def __init__(self, *scores: float) -> None:
        self.scores, self.asked = scores, list[int]()

    def segment(self, photo: np.ndarray, hints: Hints, attempt: int = 0) -> Segment:
        self.asked.append(attempt)
        return Segment(np.full(photo.shape[:2], attempt == 1), self.scores[attempt])


@pytest.mark.parametrize(
    ("scores", "asked", "kept"),
    [
        ((0.9, 1.0), [0], 0),  # good enough
        ((0.5, 0.53), [0, 1], 1),
        ((0.5, 0.51), [0, 1], 0),  # better, but by less than is wanted
        ((0.5, 0.1), [0, 1], 0),
    ],
)
def test_the_second_attempt_counts_where_it_is_clearly_better(scores, asked, kept) -> None:
    segmenter = Scripted(*scores)
    segment = draw_mask(segmenter, PHOTO, hints((4, 6)), OPTIONS)
    assert segmenter.asked == asked and segment.score == scores[kept] and segment.mask.all() == (kept == 1)


def test_agreement_is_the_share_of_good_points_inside_less_that_of_bad_ones() -> None:
    """Left half of 20 x 40: 3 of 4 accepted points lie in it, and 5 of 10 rejected ones, which 10 more doubt."""
    mask = np.zeros((20, 40), bool)
    mask[:, :20] = True
    accepted = np.array([[3.5, 5.5], [8.5, 5.5], [12.5, 5.5], [30.5, 5.5]])
    rejected = np.array([[3.5, 15.5]] * 5 + [[35.5, 15.5]] * 5)
    given = hints(mask.shape, accepted=accepted, rejected=rejected)
    assert agreement(mask, given) == pytest.approx(3 / 4 - 5 / (10 + 10))
    clicked = hints(mask.shape, accepted=accepted, positive=np.array([[35.5, 5.5]]))
    assert agreement(mask, clicked) == pytest.approx(3 / (4 + 10))  # a click weighs like ten points
