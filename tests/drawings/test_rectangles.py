# SPDX-License-Identifier: GPL-3.0-or-later
"""Frayed outlines of openings become rectangles, round ones and gables do not."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.drawings.rectangles import fit_rectangle, rectangle_stroke
from mgf_engine.drawings.trace import trace

ROW, COLUMN = np.mgrid[:60, :80]


def border(mask: np.ndarray) -> np.ndarray:
    """The outline of what a mask shows, [n, 2]."""
    return max((chain.corners for chain in trace(mask.astype(np.int32))), key=len)


def window(noise: float) -> np.ndarray:
    """A window from (20, 10) to (50, 45), whose borders are off by so much along each pixel, with a spur."""
    rng = np.random.default_rng(0)
    left, right = (np.rint(at + rng.uniform(-noise, noise, 60))[:, None] for at in (20, 50))
    top, bottom = (np.rint(at + rng.uniform(-noise, noise, 80)) for at in (10, 45))
    inside = (left <= COLUMN) & (right > COLUMN) & (top <= ROW) & (bottom > ROW)
    return inside | ((ROW >= 5) & (ROW < 20) & (COLUMN >= 30) & (COLUMN < 34))


@pytest.mark.parametrize("noise", [0.0, 2.4])
def test_a_frayed_window_is_a_rectangle(noise: float) -> None:
    box = fit_rectangle(border(window(noise)))
    assert box is not None
    np.testing.assert_allclose(box, (20, 10, 50, 45), atol=0.5 + 0.25 * noise)


@pytest.mark.parametrize(
    "mask",
    [
        np.hypot(ROW - 30, COLUMN - 40) < 20,
        (ROW > 10) & (ROW < 50) & (np.abs(COLUMN - 40) < 0.8 * (ROW - 10)),
        (ROW > 10) & (ROW < 50) & (COLUMN > 10) & (COLUMN < 60) & ((ROW < 30) | (COLUMN < 30)),
    ],
    ids=["round", "gable", "angle"],
)
def test_what_is_no_rectangle_is_none(mask: np.ndarray) -> None:
    assert fit_rectangle(border(mask)) is None


def test_the_stroke_of_a_rectangle_is_closed_level_and_upright() -> None:
    stroke = rectangle_stroke(np.array([[0.0, 3.0], [4.0, 3.0], [4.0, 0.0], [0.0, 0.0]]), (7, 7))
    assert stroke.closed and [segment.length for segment in stroke.segments] == [4, 3, 4, 3]
    assert [segment.level for segment in stroke.segments] == [True, False, True, False]
    assert [segment.upright for segment in stroke.segments] == [False, True, False, True]
