# SPDX-License-Identifier: GPL-3.0-or-later
"""Closed polyhedra of labelled cells: their faces, volumes and corners are those of the building that was put in."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
import shapely

from mgf_engine.models.solid.cells import Cells, cut_into_cells
from mgf_engine.models.solid.checks import faults_of, triangles, volume_of
from mgf_engine.models.solid.face_loops import drop_short_edges, drop_straight_corners, merge_faces, without_repeats
from mgf_engine.models.solid.model import GROUND, ROOF, WALL, Solid, SolidFace
from mgf_engine.models.solid.plan_lines import Line2
from mgf_engine.models.solid.polyhedron import make_polyhedron

#: A plan of 10 x 4, cut at x = 5, with the lines of all its sides.
SIZE = np.array([10.0, 4.0])


def line(x: float, y: float, offset: float) -> Line2:
    return Line2(np.array([x, y]), offset, -20.0, 20.0, 1.0)


CUT, SOUTH, NORTH, WEST, EAST = line(1, 0, 5), line(0, 1, 0), line(0, 1, 4), line(1, 0, 0), line(1, 0, 10)
LINES = [CUT, SOUTH, NORTH, WEST, EAST]
OUTSIDE, LEFT, RIGHT = 0, 1, 2


def solid(left: int, right: int, slopes: list[list[float]], ground: float = 0.0) -> Solid:
    """The solid whose left and right half have these labels."""
    cells = cut_into_cells([CUT], np.zeros(2), SIZE)
    label = np.array([left if _middle(cells, ring) < 5 else right for ring in cells.rings])
    return make_polyhedron(cells, label, np.array(slopes), ground, LINES)


def _middle(cells: Cells, ring: list[int]) -> float:
    return float(np.mean([cells.nodes[n][0] for n in ring]))


def kinds(found: Solid) -> Counter[str]:
    return Counter(face.kind for face in found.faces)


def area(found: Solid, kind: str) -> float:
    return sum(found.area(face) for face in found.faces if face.kind == kind)


def test_one_half_is_a_box() -> None:
    found = solid(OUTSIDE, LEFT, [[0.0, 0.0, 3.0]])
    assert faults_of(found, 1e-6) == [] and volume_of(found) == pytest.approx(5 * 4 * 3)
    assert kinds(found) == {ROOF: 1, GROUND: 1, WALL: 4} and len(found.vertices) == 8
    assert (area(found, ROOF), area(found, WALL)) == pytest.approx((20.0, 3 * 18.0))


def test_a_step_between_two_heights_is_a_wall() -> None:
    found = solid(LEFT, RIGHT, [[0.0, 0.0, 3.0], [0.0, 0.0, 6.0]], ground=-1.0)
    assert faults_of(found, 1e-6) == [] and volume_of(found) == pytest.approx(5 * 4 * 4 + 5 * 4 * 7)
    assert kinds(found) == {ROOF: 2, GROUND: 1, WALL: 5}  # front and back are one face each, beside the step
    step = [f for f in found.faces if f.kind == WALL and np.ptp(found.vertices[list(f.rings[0])][:, 0]) < 1e-6]
    assert sorted(found.area(f) for f in step) == pytest.approx([4 * 3, 4 * 4, 4 * 7])


def test_a_gable_has_no_wall_below_its_ridge() -> None:
    found = solid(LEFT, RIGHT, [[0.6, 0.0, 3.0], [-0.6, 0.0, 9.0]])
    assert faults_of(found, 1e-6) == [] and volume_of(found) == pytest.approx(10 * 4 * 4.5)
    assert kinds(found) == {ROOF: 2, GROUND: 1, WALL: 4} and len(found.vertices) == 10
    assert sorted(len(f.rings[0]) for f in found.faces if f.kind == WALL) == [4, 4, 5, 5]
    assert sorted(f.plane for f in found.faces) == [-1] * 5 + [0, 1]


def test_planes_that_cross_above_an_edge_change_places_there() -> None:
    """The left roof rises along y through the level one."""
    found = solid(LEFT, RIGHT, [[0.0, 1.0, 2.0], [0.0, 0.0, 4.0]])
    assert faults_of(found, 1e-6) == [] and volume_of(found) == pytest.approx(2 * 5 * 4 * 4)
    corners = found.vertices[np.abs(found.vertices - (5.0, 2.0, 4.0)).max(1) < 1e-6]
    assert len(corners) == 1


def test_a_court_is_a_hole_in_roof_and_ground() -> None:
    cells = cut_into_cells([line(1, 0, 3), line(1, 0, 7), line(0, 1, 1), line(0, 1, 3)], np.zeros(2), SIZE)
    inner = [
        3 < _middle(cells, ring) < 7 and 1 < np.mean([cells.nodes[n][1] for n in ring]) < 3 for ring in cells.rings
    ]
    label = np.where(inner, 0, 1)
    found = make_polyhedron(cells, label, np.array([[0.0, 0.0, 3.0]]), 0.0, [])
    assert faults_of(found, 1e-6) == [] and volume_of(found) == pytest.approx((40 - 8) * 3)
    roof = next(f for f in found.faces if f.kind == ROOF)
    assert len(roof.rings) == 2 and found.area(roof) == pytest.approx(32.0)
    assert kinds(found)[WALL] >= 8 and area(found, WALL) == pytest.approx(3 * (28 + 12))


def test_triangles_cover_the_faces_and_belong_to_them() -> None:
    found = solid(LEFT, RIGHT, [[0.6, 0.0, 3.0], [-0.6, 0.0, 9.0]])
    faces, owner = triangles(found)
    corner = found.vertices[faces]
    normal = 0.5 * np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    for k, face in enumerate(found.faces):
        assert normal[owner == k].sum(0) == pytest.approx(found.normal(face) * found.area(face))


def test_faces_that_point_inwards_have_a_negative_volume_and_a_fault() -> None:
    found = solid(OUTSIDE, LEFT, [[0.0, 0.0, 3.0]])
    turned = [replace(face, rings=tuple(ring[::-1] for ring in face.rings)) for face in found.faces]
    inside_out = replace(found, faces=turned)
    assert volume_of(inside_out) == pytest.approx(-60.0) and faults_of(inside_out, 1e-6) == ["it has no volume"]
    assert "an edge belongs to one face only" in faults_of(replace(found, faces=found.faces[1:]), 1e-6)
    bent = found.vertices + np.array([[0.0, 0.0, 0.5]]) * (np.arange(8) == 0)[:, None]
    assert "a face is not plane" in faults_of(replace(found, vertices=bent), 0.1)
    assert faults_of(replace(found, vertices=bent), 0.6) == []


def square(x: int, y: int) -> list[int]:
    """Rows of the corners of a square in a grid of 4 x 4 places, counter-clockwise."""
    return [4 * y + x, 4 * y + x + 1, 4 * (y + 1) + x + 1, 4 * (y + 1) + x]


GRID = np.array([(x, y, 0.0) for y in range(4) for x in range(4)])


def test_squares_around_a_hole_become_one_face_with_a_hole() -> None:
    rings = [square(x, y) for y in range(3) for x in range(3) if (x, y) != (1, 1)]
    (face,) = merge_faces(GRID, ROOF, 7, rings)
    assert face.plane == 7 and sorted(face.rings[1]) == [5, 6, 9, 10] and len(face.rings[0]) == 12
    (kept,) = drop_straight_corners(GRID, [face], 1e-3)
    assert sorted(kept.rings[0]) == [0, 3, 12, 15]


def test_squares_that_meet_in_a_corner_stay_two_faces() -> None:
    faces = list(merge_faces(GRID, WALL, 7, [square(0, 0), square(1, 1)]))
    assert [sorted(f.rings[0]) for f in faces] == [[0, 1, 4, 5], [5, 6, 9, 10]]
    assert all(f.plane == -1 and len(f.rings) == 1 for f in faces)


def test_short_edges_become_one_corner_and_slivers_go() -> None:
    vertices = np.array([(0, 0, 0), (4, 0, 0), (4, 0.01, 0), (4, 3, 0), (0, 3, 0)], float)
    quad, sliver = SolidFace(ROOF, ((0, 2, 3, 4),), 0), SolidFace(WALL, ((0, 1, 2),))
    assert drop_short_edges(vertices, [quad, sliver], 0.1) == [SolidFace(ROOF, ((0, 1, 3, 4),), 0)]
    assert drop_short_edges(vertices, [quad, sliver], 0.001) == [quad, sliver]
    assert without_repeats([1, 1, 2, 3, 3, 1]) == [2, 3, 1]


def test_a_polygon_of_the_plan_keeps_its_area() -> None:
    found = solid(LEFT, RIGHT, [[0.0, 0.0, 3.0], [0.0, 0.0, 6.0]])
    ground = next(f for f in found.faces if f.kind == GROUND)
    assert shapely.Polygon(found.vertices[list(ground.rings[0])][:, :2]).equals(shapely.box(0, 0, *SIZE))
    assert found.normal(ground) == pytest.approx([0, 0, -1])
