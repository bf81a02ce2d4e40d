# SPDX-License-Identifier: GPL-3.0-or-later
"""Openings cut into a wall: a flat bottom, reveals at right angles, sharp edges; none where the wall is no sheet."""

from dataclasses import replace

import numpy as np
import pytest

from mgf_engine.geometry.clean import open_edges
from mgf_engine.geometry.rasterize import face_normals
from mgf_engine.mesh.cut_openings import OpeningCutOptions, WallOpenings, cut_openings
from mgf_engine.mesh.extend_planes import ON_PLANE
from mgf_engine.model.mesh import Mesh
from mgf_engine.openings.arches import arch_drop, arch_radius
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


def wall_of(boxes=(BOX,), frame=FRAME, depth=DEPTH, rise=0.0):
    boxes = np.array(boxes).reshape(-1, 4)
    return [WallOpenings(frame, boxes, np.full(len(boxes), depth), np.full(len(boxes), rise))]


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
    result, count = cut_openings(mesh, wall_of(boxes))
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
    result, _ = cut_openings(mesh, wall_of())
    corners = result.vertices[result.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    left, top, right, bottom = BOX
    assert area == pytest.approx(150.0**2 + 2 * (right - left + top - bottom) * DEPTH, rel=1e-9)


def overhanging(mesh):
    at = mesh.vertices.copy()
    inward = np.clip(-at[:, 2] / DEPTH, 0, 1)
    at[:, 0] += 2.5 * np.sin(np.pi * inward) * np.where(at[:, 0] < 65, 1, -1) * (inward < 0.5)
    folded = replace(mesh, vertices=at)
    assert (face_normals(folded)[:, 2] < 0).any()
    return folded


def cave():
    """An opening whose pane goes on behind the wall by 30, as behind panes that mirror."""
    mesh = sloped(depth=12.0)
    at = mesh.vertices.copy()
    at[:, 0] += 30 * np.clip((-at[:, 2] / 12 - 0.5) * 2, 0, 1) * (at[:, 0] > 65)
    assert at[at[:, 2] < -6, 0].max() > BOX[2] + max(OpeningCutOptions().margins)
    return replace(mesh, vertices=at)


def without_faces(mesh, box):
    kept = ~is_in(mesh.vertices[mesh.faces].mean(1), np.array(box))
    return Mesh(mesh.vertices, mesh.faces[kept], mesh.colors)


@pytest.mark.parametrize(
    "mesh",
    [
        overhanging(sloped(slope=1.5)),
        sloped(extra=lambda u, v: np.where(np.hypot(u - 65, v - 75) < 12, 6 * np.sin(u) * np.cos(v), 0)),
        without_faces(sloped(), [60.0, 80.0, 66.0, 74.0]),
        cave(),
    ],
    ids=["overhanging slopes", "an uneven pane", "a hole in the pane", "a cave behind the wall"],
)
def test_what_the_mesh_is_within_an_opening_does_not_matter(mesh):
    result, count = cut_openings(mesh, wall_of())
    assert count == 1 and from_truth(result).max() < 1e-6 and (face_normals(result)[:, 2] > -1e-6).all()
    assert len(open_edges(result)[0]) == 400, "those around the wall"


def with_part(wall, part, at):
    vertices = np.concatenate([wall.vertices, part.vertices + np.array(at)])
    faces = np.concatenate([wall.faces, part.faces + np.int32(len(wall.vertices))])
    return Mesh(vertices, faces, np.zeros_like(vertices, np.uint8))


@pytest.mark.parametrize(("place", "stays"), [((81.5, 70.0, -6.8), False), ((81.5, 70.0, 1.0), True)])
def test_closed_parts_behind_an_opening_go_and_those_before_it_stay(place, stays):
    part = cuboid(3, 3, 3)
    result, count = cut_openings(with_part(sloped(), part, place), wall_of())
    near = np.linalg.norm(result.vertices[:, None] - (part.vertices + np.array(place)), axis=2).min(0) < 1e-9
    assert count == 1 and near.all() == near.any() == stays


def test_a_sill_before_the_wall_stays():
    left, _top, right, bottom = BOX

    def sill(u, v):
        return np.where((v < bottom - 1) & (v > bottom - 3.6) & (u > left) & (u < right), 2.0, 0.0)

    result, count = cut_openings(sloped(extra=sill), wall_of())
    assert count == 1 and result.vertices[:, 2].max() == pytest.approx(2.0, abs=0.5)


def test_values_and_colours_are_those_of_near_vertices_and_what_lies_apart_stays():
    mesh = sloped()
    colors = np.random.default_rng(0).integers(0, 255, mesh.vertices.shape).astype(np.uint8)
    mesh = replace(mesh, colors=colors, values={"views": np.arange(len(mesh.vertices))})
    result, _ = cut_openings(mesh, wall_of())
    source = result.values["views"]
    np.testing.assert_array_equal(result.colors, colors[source])
    assert (np.linalg.norm(mesh.vertices[source] - result.vertices, axis=1) < 5).all(), "those of a near vertex"
    far = mesh.vertices[~is_in(mesh.vertices, BOX, 15.0)]
    kept = {tuple(vertex) for vertex in result.vertices}
    assert all(tuple(vertex) in kept for vertex in far), "to the bit"
    same = (result.vertices == mesh.vertices[source]).all(1)
    np.testing.assert_array_equal(result.values[ON_PLANE][~same], 1)
    assert not result.values[ON_PLANE][~is_in(result.vertices, BOX, 15.0)].any()


@pytest.mark.parametrize(
    ("mesh", "depth"),
    [
        (sloped(depth=0.5), 0.5),
        (sloped(), np.inf),
        (without_faces(sloped(), [20.0, 80.0, 53.0, 40.0]), DEPTH),
        (sloped((np.array([20.0, 120.0, 110.0, 30.0]),)), DEPTH),
        (Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32), np.zeros((3, 3), np.uint8)), DEPTH),
    ],
    ids=["shallow", "a passage", "no mesh beside it", "no wall around it", "one face"],
)
def test_nothing_is_cut(mesh, depth):
    result, count = cut_openings(mesh, wall_of(depth=depth))
    assert count == 0 and result is mesh


def test_any_frame_and_scale():
    rng = np.random.default_rng(1)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    frame = WallFrame(np.array([3.0, -2.0, 7.0]), 0.02 * turn)
    mesh = sloped()
    moved = replace(mesh, vertices=frame.points(mesh.vertices))
    here, _ = cut_openings(mesh, wall_of())
    there, count = cut_openings(moved, wall_of(frame=frame), OpeningCutOptions())
    assert count == 1
    assert from_truth(replace(there, vertices=frame.coordinates(there.vertices))).max() < 1e-6
    assert len(there.faces) == len(here.faces)


# Places along the rectangle at which the mesh is looked at are 3.8 apart here, so that what is narrower is found by the
# cut alone.
WIDE = np.array([25.3, 175.1, 175.7, 25.2])


def wide(change=None):
    """A wall with an opening so wide, of vertices 1 apart; ``change`` moves them."""
    left, top, right, bottom = WIDE

    def place(u, v):
        inward = np.minimum(np.minimum(u - left, right - u), np.minimum(v - bottom, top - v))
        at = np.stack([u, v, -DEPTH * np.clip(0.5 + inward / 6, 0, 1)])
        return at if change is None else change(at)

    return joined(sheet(np.arange(201.0), np.arange(201.0), place))


def groove(at):
    """A groove of one vertex, 5 deep, that meets the left side of the opening."""
    u, v, z = at
    return np.stack([u, v, np.where((v == 65) & (u > 10) & (u < 25), -5.0, z)])


def awning(at):
    """What stands out from the opening by 8."""
    u, v, z = at
    return np.stack([u, v, np.where(np.hypot(u - 100, v - 100) < 3, 8.0, z)])


def folded(by):
    """Beside the left side of the opening the wall is folded: a row of vertices lies that much too high."""

    def change(at):
        u, v, z = at
        return np.stack([u, v + np.where((v == 65) & (u > 10) & (u < 24), by, 0.0), z])

    return change


@pytest.mark.parametrize("change", [groove, awning, folded(90.4)], ids=["a groove", "an awning", "a fold"])
def test_nothing_is_cut_where_the_rectangle_is_no_wall(change):
    assert cut_openings(wide(), wall_of((WIDE,)))[1] == 1
    mesh = wide(change)
    result, count = cut_openings(mesh, wall_of((WIDE,)))
    assert count == 0 and result is mesh


def test_small_folds_of_the_mesh_leave_no_gap():
    mesh = wide(folded(3.4))
    result, count = cut_openings(mesh, wall_of((WIDE,)))
    assert count == 1 and len(open_edges(result)[0]) == len(open_edges(mesh)[0])
    assert (face_normals(result)[is_in(result.vertices[result.faces].mean(1), WIDE), 2] > -1e-6).all()


@pytest.mark.parametrize(("width", "cut"), [(1.0, 1), (3.0, 0)])
def test_narrow_slits_of_the_mesh_along_the_rectangle_are_bridged(width, cut):
    mesh = without_faces(wide(), [10.0, 65.0 + width, 25.0, 65.0])
    result, count = cut_openings(mesh, wall_of((WIDE,)))
    assert count == cut
    if cut:
        inside = result.vertices[np.unique(result.faces[is_in(result.vertices[result.faces].mean(1), WIDE)])]
        np.testing.assert_allclose(inside[:, 2].min(), -DEPTH)


def test_a_sill_that_reaches_far_down_stays_and_the_opening_is_cut():
    left, _top, right, bottom = BOX

    def sill(u, v):
        return np.where((v < bottom - 1) & (v > bottom - 25) & (u > left - 25) & (u < right + 25), 3.5, 0.0)

    result, count = cut_openings(sloped(extra=sill), wall_of())
    assert count == 1 and (result.vertices[:, 2] > 3.4).sum() > 100


def arched(rise, slope=3.0):
    """A wall that slopes into an opening with an arched head."""
    left, top, right, bottom = BOX

    def place(u, v):
        head = top - arch_drop(u - 0.5 * (left + right), right - left, rise)
        inward = np.minimum(np.minimum(u - left, right - u), np.minimum(v - bottom, head - v))
        return u, v, -DEPTH * np.clip(0.5 + inward / (2 * slope), 0, 1)

    return joined(sheet(LINE, LINE, place))


@pytest.mark.parametrize("rise", [4.0, 15.2], ids=["segmental", "semicircle"])
def test_an_arched_head_is_cut_as_one(rise):
    left, top, right, _bottom = BOX
    result, count = cut_openings(arched(rise), wall_of(rise=rise))
    at = result.vertices
    head = top - arch_drop(at[:, 0] - 0.5 * (left + right), right - left, rise)
    away = np.hypot(at[:, 0] - 0.5 * (left + right), at[:, 1] - top + arch_radius(right - left, rise))
    on_head = np.abs(away - arch_radius(right - left, rise)) < 1e-6
    deep = at[:, 2] < -1e-6
    assert count == 1 and (at[deep, 1] < head[deep] + 1e-6).all(), "nothing is deep above the arch"
    assert (deep & on_head).sum() > 10 and (~deep & on_head & (at[:, 1] > top - rise - 1e-6)).sum() > 10
    assert len(open_edges(result)[0]) == 400, "those around the wall"
    normals = face_normals(result)
    assert (normals[:, 2] > -1e-6).all(), "nothing overhangs"
    soffit = (np.abs(normals[:, 2]) < 1e-6) & (normals[:, 1] < -0.5)
    assert soffit.sum() > 10


def test_area_of_an_arched_opening_is_that_of_its_circle():
    left, top, right, bottom = BOX
    width = right - left
    result, _ = cut_openings(arched(width / 2), wall_of(rise=width / 2))
    corners = result.vertices[result.faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] / 2
    deep = (corners[:, :, 2] < -DEPTH + 1e-6).all(1)
    half = width / 2
    assert flat[deep].sum() == pytest.approx(np.pi / 2 * half**2 + width * (top - bottom - half), rel=3e-3)
    assert flat.sum() == pytest.approx(150.0**2, rel=1e-9)
