# SPDX-License-Identifier: GPL-3.0-or-later
"""A line is the edge of the nearer of its two planes, or of the roof whose eaves it is."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.drawings.line_planes import EdgeOfPlane, edge_of_plane
from mgf_engine.drawings.model import DrawingFrame
from mgf_engine.drawings.project import Grid
from mgf_engine.drawings.regions import LOOSE, NOTHING, RegionMap
from mgf_engine.drawings.straighten import FittedSegment
from mgf_engine.drawings.trace import Chain

SIZE, MIDDLE = 60, 30.0
ROOF = (15.0, 75.0)  # degrees
#: Planes as functions of the drawing coordinates: two level walls, the second 5 behind, and a roof that goes back by 1
#: for every 1 that it rises.
FRONT, BACK, SLOPE = (0.0, 0.0, 5.0), (0.0, 0.0, 0.0), (0.0, -1.0, 40.0)


def elevation(upper: int, lower: int, planes: list[tuple[float, float, float]]) -> RegionMap:
    """Two regions, one above a level line through the middle and one below; z is up."""
    frame = DrawingFrame("A", np.zeros(3), np.array([1.0, 0, 0]), np.array([0.0, 0, 1]), np.zeros(2), np.full(2, SIZE))
    label = np.full((SIZE, SIZE), lower, np.int32)
    label[: SIZE // 2] = upper
    return RegionMap(Grid(frame, 1.0, 0.0, float(SIZE), SIZE, SIZE), label, np.array(planes))


def edge(regions: RegionMap, low: int, high: int, tilt: float = 0.0) -> EdgeOfPlane | None:
    ends = np.array([[10.0, MIDDLE - tilt], [50.0, MIDDLE + tilt]])
    span = ends[1] - ends[0]
    segment = FittedSegment(ends.mean(0), span / np.hypot(*span), float(np.hypot(*span)))
    return edge_of_plane(segment, ends, Chain(ends, low, high, (0, 1)), regions, 1.0, ROOF)


def test_the_nearer_plane_has_the_edge() -> None:
    found = edge(elevation(1, 2, [FRONT, BACK]), 1, 2)
    assert found is not None and found.label == 1 and not found.eaves
    np.testing.assert_allclose(found.across, (0, 1))
    found = edge(elevation(2, 1, [FRONT, BACK]), 1, 2)
    assert found is not None and found.label == 1
    np.testing.assert_allclose(found.across, (0, -1))


def test_before_nothing_the_only_plane_has_it_and_loose_surface_has_none() -> None:
    found = edge(elevation(NOTHING, 1, [FRONT]), NOTHING, 1)
    assert found is not None and found.label == 1
    np.testing.assert_allclose(found.across, (0, -1))
    assert edge(elevation(NOTHING, LOOSE, [FRONT]), NOTHING, LOOSE) is None


def test_where_the_plane_lies_on_both_sides_it_is_unclear() -> None:
    regions = elevation(1, 1, [FRONT, BACK])
    assert edge(regions, 1, 2) is None


@pytest.mark.parametrize("tilt", [0.0, 2.0])
def test_eaves_are_the_roofs_edge_and_level(tilt: float) -> None:
    found = edge(elevation(2, 1, [(0.0, 0.0, 20.0), SLOPE]), 1, 2, tilt)  # the wall stands before the eaves
    assert found is not None and found.eaves and found.label == 2
    assert found.segment.level and found.ends[0, 1] == pytest.approx(found.ends[1, 1])
    np.testing.assert_allclose(found.across[1], 1, atol=0.01)


def test_the_upper_edge_of_a_roof_is_no_eaves() -> None:
    found = edge(elevation(NOTHING, 1, [SLOPE]), NOTHING, 1)
    assert found is not None and not found.eaves and found.label == 1


@pytest.mark.parametrize("rise", [0.1, 10.0])
def test_what_is_flatter_or_steeper_than_a_roof_has_no_eaves(rise: float) -> None:
    found = edge(elevation(1, NOTHING, [(0.0, -1.0 / rise, 100.0)]), NOTHING, 1)
    assert found is not None and not found.eaves


def test_a_roof_below_a_roof_is_not_below_eaves() -> None:
    found = edge(elevation(2, 1, [(0.0, -2.0, 80.0), SLOPE]), 1, 2)
    assert found is not None and not found.eaves
