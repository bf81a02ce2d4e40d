# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.analytic import as_trimesh, ball, cuboid, ring
from support.meshes import empty

from benchmarks.synthetic.meshes import merged
from mgf_engine.geometry import clean
from mgf_engine.mesh.face_visibility import count_pixels
from mgf_engine.mesh.holes import boundary_loops, cap_rims, fill_holes
from mgf_engine.model.mesh import Mesh


def moved(mesh: Mesh, *offset: float) -> Mesh:
    return replace(mesh, vertices=mesh.vertices + np.array(offset))


def without(mesh: Mesh, keep) -> Mesh:
    return clean.with_faces(mesh, mesh.faces[keep])


def test_weld_joins_equal_points_and_drops_what_collapses():
    mesh = ball(subdivisions=2)
    soup = Mesh(
        mesh.vertices[mesh.faces].reshape(-1, 3),
        np.arange(3 * len(mesh.faces), dtype=np.int32).reshape(-1, 3),
        np.zeros((3 * len(mesh.faces), 3), np.uint8),
    )
    soup = replace(soup, faces=np.concatenate([soup.faces, [[0, 0, 1], [5, 6, 5]], soup.faces[:4]]).astype(np.int32))
    welded = clean.weld(soup)
    assert len(welded.vertices) == len(mesh.vertices) and len(welded.faces) == len(mesh.faces)
    assert as_trimesh(welded).is_watertight and as_trimesh(welded).is_winding_consistent


def test_parts_are_counted_by_shared_edges():
    two = merged(ball(subdivisions=1), moved(ball(subdivisions=1), 3, 0, 0))
    assert clean.parts(two).max() == 1
    touching = Mesh(
        np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]]),
        np.array([[0, 1, 2], [0, 3, 4]], np.int32),
        np.zeros((5, 3), np.uint8),
    )
    assert clean.parts(touching).tolist() in ([0, 1], [1, 0])  # one common corner does not join


def test_large_parts_are_those_of_large_area():
    big, small, speck = ball(1.0, 3), moved(ball(0.3, 3), 3, 0, 0), moved(ball(0.05, 3), -3, 0, 0)
    of_part = np.arange(3).repeat(len(big.faces))  # all have as many
    assert np.array_equal(clean.large_parts(merged(big, small, speck), 0.01), of_part < 2)
    assert clean.large_parts(merged(big, small, speck), 0.0).all()
    assert np.array_equal(clean.large_parts(merged(big, small), 1.0), of_part[: 2 * len(big.faces)] < 1)


def test_parts_inside_are_hidden():
    mesh = merged(ball(1.0, 3), ball(0.5, 3))
    counts = count_pixels(mesh, ring(6))
    assert counts.front.sum() > 1000 and counts.back.sum() == 0
    assert clean.seen_parts(mesh, counts.front + counts.back, 0.0).sum() == len(ball(1.0, 3).faces)


def test_turned_parts_are_turned_back():
    wrong = replace(ball(0.4, 3), faces=ball(0.4, 3).faces[:, ::-1].copy())
    mesh = merged(moved(ball(0.4, 3), -0.6, 0, 0), moved(wrong, 0.6, 0, 0))
    seen = count_pixels(mesh, ring(8))
    right = clean.orient_outward(mesh, seen.front, seen.back)
    assert all(part.volume > 0 for part in as_trimesh(right).split())
    seen = count_pixels(right, ring(8))
    again = clean.orient_outward(right, seen.front, seen.back)
    assert np.array_equal(again.faces, right.faces)


def test_nonmanifold_edges_are_cut_open():
    fin = Mesh(
        np.array([[0.0, 0, 0], [0, 0, 1], [1, 0, 0.5], [-1, 0.5, 0.5], [-1, -0.5, 0.5]]),
        np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]], np.int32),
        np.zeros((5, 3), np.uint8),
    )
    apart = clean.split_nonmanifold(fin)
    edges = np.sort(apart.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), 1)
    assert np.unique(edges, axis=0, return_counts=True)[1].max() <= 2
    assert np.abs(apart.vertices[apart.faces] - fin.vertices[fin.faces]).max() < 0.01
    assert len(np.unique(apart.vertices, axis=0)) == len(
        apart.vertices
    )  # nor do they join where vertices are merged by place
    whole = clean.split_nonmanifold(ball(subdivisions=2))
    assert len(whole.vertices) == len(ball(subdivisions=2).vertices)


@pytest.mark.parametrize("holes", [1, 3])
def test_small_holes_are_closed_with_the_right_orientation(holes):
    mesh = ball(subdivisions=3)
    directions = np.array([[0, 0, 1.0], [1, 0, 0], [0, -1, 0]])[:holes]
    middle = mesh.vertices[mesh.faces].mean(1)
    damaged = without(mesh, (middle @ directions.T < 0.98).all(1))
    assert len(boundary_loops(damaged)) == holes
    filled = as_trimesh(fill_holes(damaged, longest=2.0))
    assert filled.is_watertight and filled.is_winding_consistent and filled.volume > 4.0
    assert len(fill_holes(damaged, longest=0.5).faces) == len(damaged.faces)


def test_holes_that_the_photos_look_through_stay_open():
    mesh = ball(subdivisions=3)
    directions = np.array([[0, 0, 1.0], [1, 0, 0]])
    middle = mesh.vertices[mesh.faces].mean(1)
    damaged = without(mesh, (middle @ directions.T < 0.98).all(1))
    kept = fill_holes(damaged, 2.0, lambda points: points[:, 2] > 0.5)
    (rim,) = boundary_loops(kept)
    assert kept.vertices[rim][:, 2].min() > 0.8
    near = np.where(damaged.vertices[:, 2] > 0.5, 0.1, 2.0)  # what counts as small may differ from place to place
    (rim,) = boundary_loops(fill_holes(damaged, near))
    assert kept.vertices[rim][:, 2].min() > 0.8


@pytest.mark.parametrize(("free", "stays_open"), [(0.0, False), (0.4, False), (0.6, True), (1.0, True)])
def test_a_hole_stays_open_where_the_photos_look_through_half_of_it(free: float, stays_open: bool) -> None:
    damaged = without(mesh := ball(subdivisions=3), mesh.vertices[mesh.faces].mean(1)[:, 2] < 0.98)

    def is_free(points: np.ndarray) -> np.ndarray:
        return np.arange(len(points)) < free * len(points)

    assert bool(boundary_loops(fill_holes(damaged, 2.0, is_free))) == stays_open


def test_closing_carries_values():
    mesh = ball(subdivisions=3)
    mesh = replace(mesh, values={"views": np.full(len(mesh.vertices), 7, np.uint8)})
    damaged = without(mesh, mesh.vertices[mesh.faces].mean(1)[:, 2] < 0.97)
    filled = fill_holes(damaged, 2.0)
    assert len(filled.vertices) == len(damaged.vertices) + 1 == len(filled.values["views"])
    assert (clean.split_nonmanifold(clean.weld(filled)).values["views"] == 7).all()


def test_capping_makes_no_edge_of_three_faces():
    """A rim whose corners are joined by an edge already: the shortest ear would lie on a face that is there."""
    mesh = ball(subdivisions=3)
    ragged = without(
        mesh, np.random.default_rng(3).random(len(mesh.faces)) > 0.3 * (mesh.vertices[mesh.faces].mean(1)[:, 2] < -0.3)
    )
    ragged = clean.split_nonmanifold(without(ragged, ragged.vertices[ragged.faces].mean(1)[:, 2] > -0.5))
    capped = cap_rims(ragged)
    assert np.unique(clean.edge_keys(capped.faces)[0], return_counts=True)[1].max() == 2


def test_one_missing_triangle_is_put_back():
    mesh = ball(subdivisions=2)
    filled = fill_holes(without(mesh, np.arange(len(mesh.faces)) != 7), longest=10.0)
    assert len(filled.faces) == len(mesh.faces) and len(filled.vertices) == len(mesh.vertices)
    assert as_trimesh(filled).is_watertight


def test_parts_hardly_seen_go():
    mesh = merged(ball(1.0, 3), moved(ball(0.08, 3), 1.5, 0, 0))
    counts = count_pixels(mesh, ring(6))
    assert clean.seen_parts(mesh, counts.front + counts.back, 0.0).all()
    assert clean.seen_parts(mesh, counts.front + counts.back, 0.05).sum() == len(ball(1.0, 3).faces)


def test_large_patches_that_no_view_shows_go_and_small_ones_stay():
    mesh = ball(subdivisions=4)
    below, speck = mesh.vertices[:, 2] < -0.5, np.linalg.norm(mesh.vertices - [1, 0, 0], axis=1) < 0.1
    kept = clean.drop_unconfirmed(mesh, ~(below | speck), 0.01)
    middle = kept.vertices[kept.faces].mean(1)
    assert middle[:, 2].min() > -0.55
    assert (np.linalg.norm(middle - [1, 0, 0], axis=1) < 0.08).any()
    assert len(clean.drop_unconfirmed(mesh, np.ones(len(mesh.vertices), bool), 0.0).faces) == len(mesh.faces)


def test_smoothing_takes_noise_away_and_keeps_rims():
    mesh = ball(subdivisions=5)
    noise = np.random.default_rng(0).normal(size=(len(mesh.vertices), 1)) * 0.01
    rough = replace(mesh, vertices=mesh.vertices * (1 + noise))
    upper = without(rough, rough.vertices[rough.faces].mean(1)[:, 2] > 0)
    rim = np.unique(np.concatenate(boundary_loops(upper)))
    smoothed = clean.smooth(upper, 10)
    assert np.array_equal(smoothed.vertices[rim], upper.vertices[rim])
    inner = np.setdiff1d(np.arange(len(upper.vertices)), rim)
    error = np.abs(np.linalg.norm(smoothed.vertices[inner], axis=1) - 1)
    assert np.sqrt((error**2).mean()) < 0.4 * np.sqrt((noise**2).mean())
    assert clean.smooth(upper, 0) is upper


@pytest.mark.parametrize("shape", ["ball", "angle"])
def test_capped_rims_close_the_mesh(shape):
    if shape == "ball":
        mesh = without(
            ball(subdivisions=3), ball(subdivisions=3).vertices[ball(subdivisions=3).faces].mean(1)[:, 2] > -0.4
        )
    else:  # an L-shaped building without a floor: a fan around the middle would lie outside
        outline = np.array([[0.0, 0], [3, 0], [3, 1], [1, 1], [1, 3], [0, 3]])
        n = len(outline)
        vertices = np.concatenate([np.c_[outline, np.zeros(n)], np.c_[outline, np.ones(n)]])
        walls = [[i, (i + 1) % n, (i + 1) % n + n] for i in range(n)] + [[i, (i + 1) % n + n, i + n] for i in range(n)]
        mesh = Mesh(vertices, np.array(walls, np.int32), np.zeros((2 * n, 3), np.uint8))
    capped = as_trimesh(cap_rims(mesh))
    assert capped.is_watertight and capped.is_winding_consistent
    if shape == "angle":
        assert np.isclose(capped.volume, 5.0)
        assert np.isclose(capped.area, 5 + 5 + 12)  # no overlapping triangles
    else:
        assert 3.0 < capped.volume < 4.2


def test_areas():
    assert np.isclose(clean.face_areas(cuboid((0.5, 0.5, 0.5))).sum(), 6.0)


def test_empty_meshes_pass_through():
    nothing = empty()
    none = np.zeros(0, np.int64)
    for result in (
        clean.weld(nothing), clean.with_faces(nothing, nothing.faces),
        clean.orient_outward(nothing, none, none), clean.split_nonmanifold(nothing), fill_holes(nothing, 1.0),
    ):  # fmt: skip
        assert len(result.faces) == 0
    assert len(clean.seen_parts(nothing, none, 0.1)) == len(clean.large_parts(nothing, 0.1)) == 0


def test_areas_of_vertices_add_up_and_follow_the_faces():
    vertices = np.array([[0, 0, 0], [4, 0, 0], [0, 4, 0], [-1, 0, 0]], float)
    mesh = Mesh(vertices, np.array([[0, 1, 2], [0, 2, 3]], np.int32), np.zeros((4, 3), np.uint8))
    areas = clean.vertex_areas(mesh)
    assert areas.sum() == pytest.approx(10) and np.allclose(areas, [10 / 3, 8 / 3, 10 / 3, 2 / 3])
