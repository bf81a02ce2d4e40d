# SPDX-License-Identifier: GPL-3.0-or-later
"""Outlines of buildings in sparse points alone."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from mgf_engine.town.find import OutlineOptions, find_outlines, height_over_ground, outline_of

#: An L of 16 m by 12 m, turned by 20 degrees.
_L = shapely.affinity.rotate(shapely.Polygon([(0, 0), (16, 0), (16, 7), (8, 7), (8, 12), (0, 12)]), 20)


def edges_alone(seed: int) -> np.ndarray:
    """Points as on a plain house: a few along its walls, hardly any on the roof."""
    rng = np.random.default_rng(seed)
    along = shapely.line_interpolate_point(_L.exterior, rng.uniform(0, _L.length, 120))
    return np.concatenate([shapely.get_coordinates(along), rng.normal(_L.centroid.coords[0], 1.0, (3, 2))])


def iou(one: shapely.Polygon, other: shapely.Polygon) -> float:
    return float(one.intersection(other).area / one.union(other).area)


@pytest.mark.parametrize("metre", [1.0, 0.01])
@pytest.mark.parametrize("seed", range(5))
def test_a_plain_house_is_outlined_whole(seed: int, metre: float) -> None:
    outline = outline_of(edges_alone(seed) * metre, metre)
    assert iou(shapely.transform(outline, lambda points: points / metre), _L) > 0.8
    assert outline.is_valid and not outline.interiors


@pytest.mark.parametrize("across", [False, True])
def test_what_lies_between_two_walls_belongs_to_the_building(across: bool) -> None:
    """Two walls of 20 m, 4 m from each other, along x or along y; nothing shows the other two, nor the roof."""
    x = np.arange(0, 20.01, 0.4)
    walls = np.concatenate([np.column_stack([x, np.full(len(x), y)]) for y in (0.0, 4.0)])
    walls = walls[:, ::-1] if across else walls
    house = shapely.box(0, 0, *((4, 20) if across else (20, 4)))
    assert iou(outline_of(walls, 1.0), house) > 0.8


def test_a_court_wider_than_a_gap_stays_open() -> None:
    rng = np.random.default_rng(0)
    court = shapely.box(8, 0, 18, 14)
    points = rng.uniform((0, 0), (26, 22), (6000, 2))
    points = points[~shapely.contains_xy(court, points)]
    outline = outline_of(points, 1.0)
    assert outline.intersection(court).area < 0.2 * court.area
    assert outline_of(points, 1.0, OutlineOptions(widest_gap=12.0)).intersection(court).area > 0.9 * court.area


@pytest.mark.parametrize("east", [-20_000.0, 20_000.0])
def test_a_stray_point_far_away_makes_no_difference(east: float) -> None:
    """Points of the ground, which rises from west to east, and of a roof."""
    rng = np.random.default_rng(1)
    plan = rng.uniform(-40, 40, (4000, 2))
    points = np.column_stack([plan, 0.2 * plan[:, 0]])
    points[(plan > 0).all(1) & (plan < 8).all(1), 2] += 6.0
    heights = height_over_ground(np.concatenate([points, [[east, 0.0, 3.0]]]), 1.0)
    np.testing.assert_allclose(heights[:-1], height_over_ground(points, 1.0), atol=0.5)


def test_too_few_points_are_no_building() -> None:
    rng = np.random.default_rng(1)
    ground = np.column_stack([rng.uniform(-20, 20, (900, 2)), np.zeros(900)])
    roof = np.column_stack([rng.uniform(0, 8, (300, 2)), np.full(300, 6.0)])
    assert len(find_outlines(np.concatenate([ground, roof]), 1.0)) == 1
    assert find_outlines(np.concatenate([ground, roof[:20]]), 1.0) == []
