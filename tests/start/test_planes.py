# SPDX-License-Identifier: GPL-3.0-or-later
"""Planes through lines, and the points that shape the tetrahedra."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from mgf_engine.start.lines import Line3D, line_points
from mgf_engine.start.options import PlaneOptions, SegmentOptions
from mgf_engine.start.plane_points import crease_points, plane_points
from mgf_engine.start.planes import LinePlanes, dominant_directions, fit_planes_to_lines

PIXEL = 0.01


def line(a: ArrayLike, b: ArrayLike) -> Line3D:
    ends = np.array([a, b], float)
    shown = np.tile([[0.0, np.linalg.norm(ends[1] - ends[0])]], (4, 1))
    return Line3D(ends, np.arange(4), shown)


def frame(z: float) -> list[Line3D]:
    """The edges of a square of 2 x 2 and a window in it, at height ``z``."""
    outer = [[0, 0, z], [2, 0, z], [2, 2, z], [0, 2, z]]
    inner = [[0.5, 0.5, z], [1.2, 0.5, z], [1.2, 1.2, z], [0.5, 1.2, z]]
    return [line(c[k], c[(k + 1) % 4]) for c in (outer, inner) for k in range(4)]


def test_a_plane_with_its_lines_is_found_once() -> None:
    found = fit_planes_to_lines(frame(1.0), PIXEL, PlaneOptions())
    assert len(found.planes) == 1 and len(found.members[0]) == 8
    np.testing.assert_allclose(np.abs(found.planes[0]), [0, 0, 1, 1], atol=1e-9)
    assert len(fit_planes_to_lines([], PIXEL, PlaneOptions()).planes) == 0
    assert len(fit_planes_to_lines([line([0, 0, 0], [1, 0, 0])], PIXEL, PlaneOptions()).planes) == 0


def test_a_wall_whose_lines_all_lie_on_its_neighbours_is_found_after_the_maximum() -> None:
    corners = np.array(list(np.ndindex(2, 2, 2))) * 2.0
    edges = [line(a, b) for a, b in combinations(corners, 2) if (a != b).sum() == 1]
    edges.append(line([0, 0.9, 1], [2, 0.9, 1.06]))  # along no plane: its ends are 3 px off the one through its middle
    assert len(fit_planes_to_lines(edges, PIXEL, PlaneOptions(most=4, separate=10)).planes) == 4
    found = fit_planes_to_lines(edges, PIXEL, PlaneOptions(most=4))
    assert len(found.planes) == 6 and all(len(members) == 4 for members in found.members)
    np.testing.assert_array_equal(found.strength, found.strength[0])
    assert len(np.unique(np.abs(found.planes).round(6), axis=0)) == 6


def test_after_the_maximum_no_plane_is_found_beside_a_parallel_one() -> None:
    lines = frame(1.0) + frame(1.0 + 10 * PIXEL) + frame(1.0 + 50 * PIXEL)
    assert len(fit_planes_to_lines(lines, PIXEL, PlaneOptions(most=3)).planes) == 3
    offsets = np.sort(np.abs(fit_planes_to_lines(lines, PIXEL, PlaneOptions(most=1)).planes[:, 3]))
    assert len(offsets) == 2 and np.ptp(offsets) > PlaneOptions().rectangle_layer * PIXEL


def test_two_long_lines_side_by_side_and_a_short_one_across_make_a_plane() -> None:
    """The short line alone tells the plane to some degrees only: a metre on it is far off the other long line."""
    sides = [line([0, y, 0], [2, y, 0]) for y in (0, 2)]
    across = line([1, 1.0, -0.004], [1, 1.12, 0.004])
    found = fit_planes_to_lines([*sides, across], PIXEL, PlaneOptions())
    assert len(found.planes) == 1 and found.members[0].tolist() == [0, 1, 2]
    np.testing.assert_allclose(np.abs(found.planes[0]), [0, 0, 1, 0], atol=1e-2)
    assert len(fit_planes_to_lines(sides, PIXEL, PlaneOptions()).planes) == 0  # nothing runs another way


def test_directions_are_those_of_the_lines() -> None:
    d = np.array([[1.0, 0, 0], [-1, 0.01, 0], [0, 1, 0], [0, 0, 1]])
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    found = dominant_directions(d, np.array([2.0, 2, 1, 0.01]), PlaneOptions())
    assert len(found) == 2
    np.testing.assert_allclose(np.abs(found), [[1, 0, 0], [0, 1, 0]], atol=0.02)


def test_a_plane_is_covered_by_points_but_not_where_dense_ones_lie_beside_it() -> None:
    lines, o = frame(1.0), PlaneOptions()
    planes = fit_planes_to_lines(lines, PIXEL, o)
    points, owner = plane_points(planes, lines, np.zeros((0, 3)), PIXEL, o)
    np.testing.assert_allclose(points[:, 2], 1.0, atol=1e-9)
    assert len(points) > 0.9 * (2 / (o.grid * PIXEL)) ** 2 and not owner.any()
    x, y = np.meshgrid(np.arange(1.3, 2.0, 0.03), np.arange(-0.2, 2.2, 0.03))
    vault = np.stack([x.ravel(), y.ravel(), np.full(x.size, 1.05)], 1)
    fewer, _ = plane_points(planes, lines, vault, PIXEL, o)
    assert ((fewer[:, 0] < 1.3) | (fewer[:, 0] > 2.0)).all() and len(fewer) > 0.5 * len(points)
    same, _ = plane_points(planes, lines, vault - [0, 0, 0.05], PIXEL, o)
    assert len(same) == len(points)


def test_foot_and_corner_of_a_wall_tell_all_of_it() -> None:
    o = PlaneOptions()
    wall = LinePlanes(np.array([[0, 1.0, 0, 0]]), [[0, 1]], np.ones(1))
    foot, corner = line([0, 0, 0], [3, 0, 0]), line([3, 0, 0], [3, 0, 2])
    points, _ = plane_points(wall, [foot, corner], np.zeros((0, 3)), PIXEL, o)
    opposite = (points[:, 0] < 1) & (points[:, 2] > 1)
    assert opposite.sum() > 0.9 / (o.grid * PIXEL) ** 2
    np.testing.assert_allclose(points[:, 1], 0, atol=1e-12)


def test_of_parallel_planes_only_the_stronger_one_covers_its_rectangle() -> None:
    o = PlaneOptions()
    lines = [line([0, y, 0], [3, y, 0]) for y in (0, 0.2)] + [line([3, y, 0], [3, y, 2]) for y in (0, 0.2)]
    walls = LinePlanes(np.array([[0, 1.0, 0, 0], [0, 1.0, 0, -0.2]]), [[0, 2], [1, 3]], np.array([2.0, 1.0]))
    points, owner = plane_points(walls, lines, np.zeros((0, 3)), PIXEL, o)
    opposite = (points[:, 0] < 0.5) & (points[:, 2] > 1.5)
    assert (opposite & (owner == 0)).any() and not (opposite & (owner == 1)).any() and (owner == 1).sum() > 100


def test_lines_of_one_direction_tell_no_more_than_their_hull() -> None:
    o = PlaneOptions()
    chord = LinePlanes(np.array([[0, 1.0, 0, 0]]), [[0, 1]], np.ones(1))
    ridge, eave = line([0, 0, 2], [3, 0, 2]), line([2, 0, 0], [3, 0, 0])
    points, _ = plane_points(chord, [ridge, eave], np.zeros((0, 3)), PIXEL, o)
    assert len(points) and not ((points[:, 0] < 0.5) & (points[:, 2] < 0.5)).any()
    along_one = [line([0, 0, 0], [3, 0, 0]), line([4, 0, 0], [5, 0, 0])]
    assert not len(plane_points(chord, along_one, np.zeros((0, 3)), PIXEL, o)[0])  # no area


def test_creases_lie_on_both_planes() -> None:
    o = PlaneOptions(grid=12.0, crease=5.0, crease_reach=1.0)
    planes = LinePlanes(np.array([[0, 0, 1.0, 0], [1.0, 0, 0, 0]]), [], np.ones(2))
    grid = np.stack(np.meshgrid(np.arange(0, 1, 0.1), np.arange(0, 1, 0.1), indexing="ij"), -1).reshape(-1, 2)
    flat = np.c_[grid, np.zeros(len(grid))]
    points = np.concatenate([flat, flat[:, [2, 1, 0]]])
    found = crease_points(planes, points, np.repeat([0, 1], len(flat)), PIXEL, o)
    assert len(found) > 15 and np.abs(found[:, [0, 2]]).max() < 1e-9
    apart = points + np.repeat([[0.5, 0, 0], [0, 0, 0.5]], len(flat), axis=0)
    assert not len(crease_points(planes, apart, np.repeat([0, 1], len(flat)), PIXEL, o))


def test_points_of_a_line_lie_where_three_views_show_it() -> None:
    part = Line3D(np.array([[0.0, 0, 0], [1, 0, 0]]), np.arange(4), np.array([[0, 1], [0, 1], [0.5, 1], [0.6, 1.0]]))
    points, seen = line_points([part], PIXEL, SegmentOptions(step=5.0))
    assert points[:, 0].min() >= 0.44 and points[:, 0].max() <= 1.0 + 1e-9
    assert {len(s) for s in seen} == {3, 4} and len(seen) == len(points)


def test_lines_of_two_views_get_points_where_two_suffice() -> None:
    part = Line3D(np.array([[0.0, 0, 0], [1, 0, 0]]), np.arange(2), np.array([[0, 1], [0.5, 1.0]]))
    points, seen = line_points([part], PIXEL, SegmentOptions(least_views=2))
    assert points[:, 0].min() > 0.45 and {len(s) for s in seen} == {2}
