# SPDX-License-Identifier: GPL-3.0-or-later
"""Segments on one line become one; those beside it, across it or beyond a gap stay."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.drawings.merge_segments import merge_segments

PIXEL = 0.01
Segment = tuple[tuple[float, float], tuple[float, float]]


def merged(*segments: Segment) -> list[list[float]]:
    """The ends of each, left one first."""
    found = merge_segments([(np.array(a, float), np.array(b, float)) for a, b in segments], PIXEL)
    return sorted([c for end in sorted([a.tolist(), b.tolist()]) for c in end] for a, b in found)


def test_nothing_stays_nothing_and_points_are_no_segments() -> None:
    assert merged() == []
    assert merged(((1, 1), (1, 1))) == []


@pytest.mark.parametrize("start", [0.5, 1.0, 1.0 + 0.9 * PIXEL])
@pytest.mark.parametrize("turned", [False, True])
def test_segments_that_overlap_or_touch_are_merged(start: float, turned: bool) -> None:
    second = ((2.0, 0.0), (start, 0.0)) if turned else ((start, 0.0), (2.0, 0.0))
    found = merged(((0.0, 0.0), (1.0, 0.0)), second)
    np.testing.assert_allclose(found, [[0, 0, 2, 0]], atol=1e-12)


@pytest.mark.parametrize(
    "second",
    [
        ((1.0 + 1.5 * PIXEL, 0.0), (2.0, 0.0)),  # a gap
        ((0.5, PIXEL), (2.0, PIXEL)),  # another line beside it
        ((0.5, -0.5), (0.5, 0.5)),  # across
        ((0.95, 0.0), (1.05, 0.004)),  # 2.3 degrees off
    ],
)
def test_others_stay(second: Segment) -> None:
    assert len(merged(((0.0, 0.0), (1.0, 0.0)), second)) == 2


def test_a_chain_is_merged_whatever_its_order() -> None:
    pieces = [((k, 0.0), (k + 1.0, 0.0)) for k in (3.0, 0.0, 4.0, 1.0, 2.0)]
    np.testing.assert_allclose(merged(*pieces), [[0, 0, 5, 0]], atol=1e-12)


def test_the_longest_gives_the_line() -> None:
    found = merged(((0.0, 0.0), (10.0, 0.0)), ((9.9, 0.004), (11.0, 0.004)))
    np.testing.assert_allclose(found, [[0, 0, 11, 0]], atol=1e-12)
