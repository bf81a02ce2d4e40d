# SPDX-License-Identifier: GPL-3.0-or-later
"""Openings cut into a wall: a flat bottom, reveals at right angles, sharp edges; nothing where the mesh is no sheet."""

from dataclasses import replace

import numpy as np
import pytest

from mgf_engine.geometry.clean import open_edges
from mgf_engine.geometry.rasterize import face_normals
from mgf_engine.mesh.cut_openings import CutOptions, WallOpenings, cut_openings
from mgf_engine.mesh.extend_planes import ON_PLANE
from mgf_engine.model.mesh import Mesh
from mgf_engine.openings.wall_frame import WallFrame
from tests.support.sheets import box as cuboid
from tests.support.sheets import joined, sheet

LINE = np.arange(0, 151.0, 1.5)
BOX = np.array([50.3, 95.1, 80.7, 55.2])  # left, top, right, bottom
DEPTH = 3.0
FRAME = WallFrame(np.zeros(3), np.eye(3))


def sloped(boxes=(BOX,), slope=3.0, depth=DEPTH, extra=None):
    """A wall in z = 0 that faces +z and slopes into openings over ``slope`` to either side of their edges."""

    def place(u, v):
        z = np.zeros(len(u))
        for left, top, right, bottom in boxes:
            inward = np.minimum(np.minimum(u - left, right - u), np.minimum(v - bottom, top - v))
            z -= depth * np.clip(0.5 + inward / (2 * slope), 0, 1)
        return u, v, z if extra is None else z + extra(u, v)

    return joined(sheet(LINE, LINE, place))


def wall_of(mesh, boxes=(BOX,), frame=FRAME):
    return [WallOpenings(frame, np.array(boxes).reshape(-1, 4), np.arange(len(mesh.faces)))]


def is_in(points, box, slack=1e-9):
    left, top, right, bottom = box
    return ((points[:, :2] > np.array([left, bottom]) - slack) & (points[:, :2] < np.array([right, top]) + slack)).all(
        1
    )


def from_truth(mesh, boxes=(BOX,), depth=DEPTH):
    """How far the vertices are from the wall with sharp openings."""
    at = mesh.vertices
    away = np.abs(at[:, 2])
    for box in boxes:
        inside = is_in(at, box)
        to_edge = np.abs(at[:, [0, 1, 0, 1]] - box).min(1)
        reveal = np.where((at[:, 2] > -depth - 1e-9) & (at[:, 2] < 1e-9), to_edge, np.inf)
        away = np.where(inside, np.minimum(np.abs(at[:, 2] + depth), reveal), away)
    return away


@pytest.mark.parametrize("boxes", [(BOX,), (BOX, BOX + 36.0 * np.array([1, 0, 1, 0]))], ids=["one", "two side by side"])
def test_the_slope_becomes_a_sharp_opening(boxes):
    mesh = sloped(boxes)
    assert from_truth(mesh, boxes).max() > 1.2
    result, count = cut_openings(mesh, wall_of(mesh, boxes))
    assert count == len(boxes)
    assert from_truth(result, boxes).max() < 1e-6
    assert len(open_edges(result)[0]) == len(open_edges(mesh)[0]), "the faces hang together as before"
    normals = face_normals(result)
    level, upright = normals[:, 2] > 1 - 1e-6, np.abs(normals[:, 2]) < 1e-6
    assert (level | upright).all() and upright.sum() > 80
    centre = result.vertices[result.faces[upright]].mean(1)
    middle = np.array([[(b[0] + b[2]) / 2, (b[1] + b[3]) / 2, -DEPTH / 2] for b in boxes])
    to_middle = middle[np.linalg.norm(centre[:, None] - middle, axis=2).argmin(1)] - centre
    assert (np.einsum("ij,ij->i", to_middle, normals[upright]) > 0).all(), "reveals face into the opening"


def test_area_of_the_wall_bottom_and_reveals_is_that_of_a_box():
    mesh = sloped()
    result, _ = cut_openings(mesh, wall_of(mesh))
    corners = result.vertices[result.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    left, top, right, bottom = BOX
    assert area == pytest.approx(150.0**2 + 2 * (right - left + top - bottom) * DEPTH, rel=1e-9)


def test_slopes_that_overhang_are_unfolded():
    mesh = sloped(slope=1.5)
    at = mesh.vertices.copy()
    inward = np.clip(-at[:, 2] / DEPTH, 0, 1)
    at[:, 0] += 2.5 * np.sin(np.pi * inward) * np.where(at[:, 0] < 65, 1, -1) * (inward < 0.5)
    folded = replace(mesh, vertices=at)
    assert (face_normals(folded)[:, 2] < 0).any()
    result, count = cut_openings(folded, wall_of(mesh))
    assert count == 1 and from_truth(result).max() < 1e-6 and (face_normals(result)[:, 2] > -1e-6).all()


@pytest.mark.parametrize("side", [3, 6])
def test_a_closed_part_that_floats_beside_an_opening_stays_as_it_is(side):
    wall, part = sloped(), cuboid(side, side, side)
    start = len(wall.vertices)
    vertices = np.concatenate([wall.vertices, part.vertices + np.array([81.5, 70.0, -0.8 - side])])
    both = Mesh(vertices, np.concatenate([wall.faces, part.faces + np.int32(start)]), np.zeros_like(vertices, np.uint8))
    result, count = cut_openings(both, wall_of(both))
    assert count == 1 and np.isfinite(result.vertices).all()
    np.testing.assert_allclose(result.vertices[start : len(vertices)], vertices[start:], atol=1e-9)


def test_values_colours_and_what_lies_apart_stay():
    mesh = sloped()
    colors = np.random.default_rng(0).integers(0, 255, mesh.vertices.shape).astype(np.uint8)
    mesh = replace(mesh, colors=colors, values={"views": np.arange(len(mesh.vertices))})
    result, _ = cut_openings(mesh, wall_of(mesh))
    far = ~is_in(mesh.vertices, BOX, 9.0)
    count = len(mesh.vertices)
    np.testing.assert_allclose(result.vertices[:count][far], mesh.vertices[far], atol=1e-9)
    np.testing.assert_array_equal(result.colors[:count], colors)
    new = result.values["views"][count:]
    assert (np.linalg.norm(mesh.vertices[new] - result.vertices[count:], axis=1) < 5).all(), "those of a near vertex"
    moved = np.linalg.norm(result.vertices[:count] - mesh.vertices, axis=1) > 1e-6
    assert result.values[ON_PLANE][:count][moved].all() and result.values[ON_PLANE][count:].all()


def with_hole(mesh):
    centre = mesh.vertices[mesh.faces].mean(1)
    kept = ~is_in(centre, np.array([60.0, 80.0, 66.0, 74.0]))
    return Mesh(mesh.vertices, mesh.faces[kept], mesh.colors)


@pytest.mark.parametrize(
    "mesh",
    [
        sloped(depth=0.5),
        sloped(extra=lambda u, v: np.where(np.hypot(u - 65, v - 75) < 12, 6 * np.sin(u) * np.cos(v), 0)),
        with_hole(sloped()),
        Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32), np.zeros((3, 3), np.uint8)),
    ],
    ids=["shallow", "uneven", "a hole", "no sheet"],
)
def test_what_is_no_sheet_with_a_flat_bottom_stays(mesh):
    result, count = cut_openings(mesh, wall_of(mesh))
    assert count == 0 and result is mesh


def test_any_frame_and_scale():
    rng = np.random.default_rng(1)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    frame = WallFrame(np.array([3.0, -2.0, 7.0]), 0.02 * turn)
    mesh = sloped()
    moved = replace(mesh, vertices=frame.points(mesh.vertices))
    here, _ = cut_openings(mesh, wall_of(mesh))
    there, count = cut_openings(moved, wall_of(moved, frame=frame), CutOptions())
    assert count == 1
    assert from_truth(replace(there, vertices=frame.coordinates(there.vertices))).max() < 1e-6
    assert len(there.faces) == len(here.faces)
