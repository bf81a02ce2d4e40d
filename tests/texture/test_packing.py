# SPDX-License-Identifier: GPL-3.0-or-later
"""Rectangles in a picture: none over another, and little room lost."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mgf_engine.texture.packing import LOW, SHELF, pack

SIZES = st.lists(st.tuples(st.integers(1, 60), st.integers(1, 60)), min_size=1, max_size=40)


def taken(sizes: np.ndarray, corner: np.ndarray, side: int) -> np.ndarray:
    """How many rectangles lie on each pixel of the square; fails where one leaves it."""
    found = np.zeros((side, side), int)
    for (x, y), (w, h) in zip(corner, sizes, strict=True):
        assert x >= 0 and y >= 0 and x + w <= side and y + h <= side
        found[y : y + h, x : x + w] += 1
    return found


@settings(max_examples=60, deadline=None)
@given(SIZES, st.integers(64, 400))
def test_rectangles_do_not_overlap(sizes: list[tuple[int, int]], side: int) -> None:
    corner = pack(np.array(sizes), side)
    if corner is None:
        assert sum(w * h for w, h in sizes) > 0.2 * side * side  # some room is lost, but not that much
        return
    assert taken(np.array(sizes), corner, side).max() == 1


@pytest.mark.parametrize("count", [50, 2000])
def test_a_few_large_and_many_small_ones_fill_most_of_the_picture(count: int) -> None:
    rng = np.random.default_rng(count)
    large = rng.integers(60, 500, (30, 2))
    sizes = np.concatenate([rng.integers(7, 30, (count, 2)), large])
    corner = pack(sizes, 2048)
    assert corner is not None and taken(sizes, corner, 2048).max() == 1
    height = (corner + sizes)[:, 1].max()
    assert sizes.prod(1).sum() > 0.8 * 2048 * height


def test_one_that_is_wider_or_higher_than_the_picture_does_not_fit() -> None:
    assert pack(np.array([[65, 3]]), 64) is None and pack(np.array([[3, 65]]), 64) is None
    assert pack(np.array([[SHELF + 1, LOW]]), SHELF) is None
    found = pack(np.array([[64, 64]]), 64)
    assert found is not None and found.tolist() == [[0, 0]]


def test_nothing_needs_no_room() -> None:
    found = pack(np.zeros((0, 2), np.int64), 64)
    assert found is not None and found.shape == (0, 2)
