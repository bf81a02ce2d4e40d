# SPDX-License-Identifier: GPL-3.0-or-later
"""Openings in a depth map of a wall, a pixel of the map a ground pixel: rectangles, their depths, and what is none."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.openings.detection import (
    Opening,
    OpeningDetectionOptions,
    align_edges,
    openings_in,
    without_doubles,
)

BOX = (40, 30, 80, 90)  # left, top, right, bottom
INSIDE = (slice(BOX[1], BOX[3]), slice(BOX[0], BOX[2]))


def wall(depth: float | np.ndarray = 3.0, slope: float = 0.0) -> np.ndarray:
    """A wall of 160 x 120 pixels with an opening so deep, which the map slopes into over twice ``slope``."""
    row, column = np.mgrid[:120, :160] + 0.5
    left, top, right, bottom = BOX
    inward = np.minimum(np.minimum(column - left, right - column), np.minimum(row - top, bottom - row))
    share = np.clip(0.5 + inward / (2 * slope), 0, 1) if slope else (inward > 0).astype(float)
    return (share * depth).astype(np.float32)


def found(depth: np.ndarray, pixel: float = 1.0, options=OpeningDetectionOptions()) -> list[Opening]:
    return list(openings_in(depth, pixel, pixel, depth.size, options))


@pytest.mark.parametrize("slope", [0.0, 3.0])
def test_an_opening_is_where_the_map_is_half_as_deep(slope: float) -> None:
    (one,) = found(wall(slope=slope))
    np.testing.assert_allclose(one.box, BOX, atol=0.05)
    assert one.depth == pytest.approx(3) and 0.9 < one.score <= 1


def test_the_unit_of_the_map_does_not_matter() -> None:
    (one,) = found(0.02 * wall(slope=3.0), 0.02)
    np.testing.assert_allclose(one.box, BOX, atol=0.05)
    assert one.depth == pytest.approx(0.06)


@pytest.mark.parametrize(("depth", "passage"), [(13.5, False), (14.0, True), (200.0, True)])
def test_a_passage_has_no_bottom(depth: float, passage: bool) -> None:
    (one,) = found(wall(depth))
    assert np.isinf(one.depth) == passage and (passage or one.depth == pytest.approx(depth))


def test_an_option_says_from_where_on_it_is_one() -> None:
    (one,) = found(wall(9.0), options=OpeningDetectionOptions(deepest=8.0))
    assert np.isinf(one.depth)


def test_a_hole_of_the_map_within_an_opening_is_as_deep() -> None:
    depth = wall()
    depth[50:80, 50:70] = np.nan
    (one,) = found(depth)
    np.testing.assert_allclose(one.box, BOX, atol=0.05)


@pytest.mark.parametrize(
    "hole", [(slice(100, 115), slice(90, 130)), (slice(35, 85), slice(55, 100))], ids=["alone", "half in an opening"]
)
def test_a_hole_of_the_map_in_the_wall_is_no_opening(hole: tuple[slice, slice]) -> None:
    depth = wall()
    depth[hole] = np.nan
    assert all(BOX[2] + 1 > one.box[2] for one in found(depth)), "none reaches into the hole"


def test_the_depth_of_an_even_opening_is_its_median_and_that_of_one_whose_pane_mirrors_a_lower_quantile() -> None:
    rng = np.random.default_rng(0)
    even = wall(rng.uniform(2.8, 3.2, (120, 160)))
    mirroring = wall(rng.uniform(2.0, 10.0, (120, 160)))
    assert found(even)[0].depth == pytest.approx(3.0, abs=0.03)
    (one,) = found(mirroring)
    assert one.depth == pytest.approx(2.0 + 0.35 * 8.0, abs=0.3)
    np.testing.assert_allclose(one.box, BOX, atol=1.0)


def test_a_pane_that_comes_forward_to_the_wall_in_places_is_one_opening() -> None:
    depth = wall()
    depth[45:60, 56:64] = 0.0
    (one,) = found(depth)
    np.testing.assert_allclose(one.box, BOX, atol=1.0)


def round_window() -> np.ndarray:
    row, column = np.mgrid[:120, :160] + 0.5
    return np.where(np.hypot(column - 60, row - 60) < 25, np.float32(3), np.float32(0))


@pytest.mark.parametrize(
    ("depth", "change"),
    [
        (wall(0.9), {}),
        (wall(-3.0), {}),
        (wall(), {"side": 45.0}),
        (wall(), {"largest": 0.1}),
        (wall(), {"shape": 0.05}),
        (round_window(), {}),
        (np.where(np.arange(160) < 60, np.float32(3), np.float32(0)) * np.ones((120, 1), np.float32), {}),
    ],
    ids=["shallow", "before the wall", "narrow", "large", "deep for its width", "round", "set back"],
)
def test_what_is_no_opening_is_none(depth: np.ndarray, change: dict[str, float]) -> None:
    assert found(depth, options=OpeningDetectionOptions(**change)) == []


def test_of_two_that_overlap_the_one_of_the_higher_score_stays() -> None:
    window, pane = np.array([0.0, 0, 40, 60]), np.array([5.0, 5, 20, 20])
    beside = np.array([38.0, 0, 80, 60])
    some = [Opening(0.8, pane, 3.0), Opening(0.9, window, 3.0), Opening(0.7, beside, 3.0)]
    assert without_doubles(some) == [1, 2]
    assert without_doubles([]) == []


def test_edges_within_a_distance_are_put_on_one_line() -> None:
    boxes = np.array([[0.0, 10.0, 20.0, 50.0], [40.0, 11.0, 60.0, 50.5], [80.0, 16.0, 100.0, 52.0]])
    aligned = align_edges(boxes, 3.0)
    assert aligned[:, 1].tolist() == [10.5, 10.5, 16.0] and np.ptp(aligned[:, 3]) == 0
    np.testing.assert_array_equal(aligned[:, [0, 2]], boxes[:, [0, 2]])
