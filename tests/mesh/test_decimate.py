# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

from dataclasses import replace

import igl
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.analytic import as_trimesh, ball, cuboid, mesh_of

from mgf_engine.errors import Cancelled
from mgf_engine.geometry import clean
from mgf_engine.geometry.clip import clip
from mgf_engine.mesh import decimate
from mgf_engine.mesh.decimate import SLAB_FACES, reduce_faces
from mgf_engine.mesh.holes import boundary_loops
from mgf_engine.model.mesh import Mesh
from mgf_engine.native import library


def fine_box(times=5) -> Mesh:
    box = as_trimesh(cuboid())
    for _ in range(times):
        box = box.subdivide()
    return mesh_of(box)


def noisy(mesh: Mesh, size: float, seed=0) -> Mesh:
    return replace(mesh, vertices=mesh.vertices + np.random.default_rng(seed).normal(size=mesh.vertices.shape) * size)


def holed(mesh: Mesh, direction, share=0.9) -> Mesh:
    middle = mesh.vertices[mesh.faces].mean(1)
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    return clean.with_faces(mesh, mesh.faces[middle @ np.array(direction, float) < share])


def distances(points, mesh: Mesh):
    return np.sqrt(igl.point_mesh_squared_distance(points, mesh.vertices, mesh.faces.astype(np.int64))[0])


def topology(mesh: Mesh):
    """Euler characteristic, open rims and connected parts."""
    keys = np.unique(clean.edge_keys(mesh.faces)[0])
    return len(mesh.vertices) - len(keys) + len(mesh.faces), len(boundary_loops(mesh)), int(clean.parts(mesh).max()) + 1


def check_clean(mesh: Mesh) -> None:
    assert np.unique(clean.edge_keys(mesh.faces)[0], return_counts=True)[1].max() <= 2
    assert igl.is_vertex_manifold(mesh.faces.astype(np.int64))[0]
    assert as_trimesh(mesh).is_winding_consistent
    assert clean.face_areas(mesh).min() > 0
    assert len(np.unique(mesh.faces)) == len(mesh.vertices)
    assert len(np.unique(np.sort(mesh.faces, 1), axis=0)) == len(mesh.faces)


@settings(max_examples=15, deadline=None)
@given(
    st.sampled_from(["ball", "box", "torus", "holed", "two"]), st.floats(0.0, 0.03), st.floats(0.003, 0.1),
    st.integers(0, 3), st.sampled_from([-1.0, 0.0, 5.0]),
)  # fmt: skip
def test_what_was_clean_stays_clean_and_near(shape, noise, tolerance, seed, color_tolerance):
    import trimesh

    mesh = {
        "ball": lambda: ball(subdivisions=4),
        "box": lambda: fine_box(4),
        "torus": lambda: mesh_of(trimesh.creation.torus(1.0, 0.3, 48, 24)),
        "holed": lambda: holed(holed(ball(subdivisions=4), (0, 0, -1)), (1, 0, 0), 0.97),
        "two": lambda: mesh_of(trimesh.util.concatenate([as_trimesh(ball()), as_trimesh(ball()).apply_scale(0.5)])),
    }[shape]()
    mesh = noisy(mesh, noise, seed)
    reduced = reduce_faces(mesh, 0, tolerance, color_tolerance)
    check_clean(reduced)
    assert topology(reduced) == topology(mesh)
    assert distances(mesh.vertices, reduced).max() <= tolerance * 1.001 + 1e-6
    assert len(reduced.faces) <= len(mesh.faces)


def test_a_flat_wall_needs_few_faces_and_its_edges_stay():
    box = fine_box()
    reduced = reduce_faces(box, 0, 0.01)
    assert len(box.faces) == 12288 and len(reduced.faces) < 60
    assert np.isclose(as_trimesh(reduced).volume, as_trimesh(box).volume, rtol=0.01)
    assert np.isclose(as_trimesh(reduced).area, as_trimesh(box).area, rtol=0.01)
    rough = reduce_faces(noisy(box, 0.002), 0, 0.01)
    assert len(rough.faces) < 1000
    normals = as_trimesh(rough).face_normals[as_trimesh(rough).area_faces > 0.01]
    assert np.median(np.abs(normals).max(1)) > 0.99


def test_the_bound_decides_how_many_faces_are_left():
    mesh = ball(subdivisions=5)
    counts = [len(reduce_faces(mesh, 0, t).faces) for t in (0.001, 0.003, 0.01)]
    assert counts[0] > 1.7 * counts[1] > 2.9 * counts[2]
    for tolerance in (0.003, 0.01):
        reduced = reduce_faces(mesh, 0, tolerance)
        assert distances(mesh.vertices, reduced).max() <= tolerance
        assert distances(reduced.vertices, mesh).max() <= 1.5 * tolerance  # nothing sticks out either
        assert ((as_trimesh(reduced).face_normals * reduced.vertices[reduced.faces].mean(1)).sum(1) > 0).all()


def test_the_bound_is_local():
    mesh = ball(subdivisions=5)
    coarse = mesh.vertices[:, 0] > 0
    reduced = reduce_faces(mesh, 0, np.where(coarse, 0.02, 0.001).astype(np.float32))
    error = distances(mesh.vertices, reduced)
    assert error[~coarse].max() <= 0.0011 and 0.004 < error[coarse].max() <= 0.0201
    sides = np.sign(reduced.vertices[reduced.faces].mean(1)[:, 0])
    assert (sides < 0).sum() > 4 * (sides > 0).sum()


@pytest.mark.parametrize("color_tolerance", [-1.0, 6.0])
def test_the_count_is_met_where_tolerances_ask_for_more(color_tolerance):
    mesh = noisy(ball(subdivisions=5), 0.01)
    for most in (5000, 400):
        reduced = reduce_faces(mesh, most, 2e-3, color_tolerance)
        assert most * 0.98 <= len(reduced.faces) <= most
        check_clean(reduced)
        assert topology(reduced) == topology(mesh)
    assert np.abs(np.linalg.norm(reduce_faces(mesh, 1000).vertices, axis=1) - 1).max() < 0.05
    assert reduce_faces(mesh, 0) is mesh and reduce_faces(mesh, 10**6) is mesh


def test_rims_stay_where_they_are():
    mesh = clip(ball(subdivisions=5), np.array([[0.0, 0.0, 1.0, 0.6], [1.0, 0.0, 0.0, 0.9]]))
    reduced = reduce_faces(mesh, 0, 0.005)
    assert len(boundary_loops(mesh)) == len(boundary_loops(reduced)) == 2
    for axis, cut in ((2, -0.6), (0, -0.9)):
        before, after = (next(r for r in rims(m) if np.isclose(r[0, axis], cut)) for m in (mesh, reduced))
        assert len(after) < len(before) / 2 and np.abs(after[:, axis] - cut).max() < 1e-9
        steps = np.linspace(0, 1, 50)[:, None, None]
        line = ((1 - steps) * after + steps * np.roll(after, -1, axis=0)).reshape(-1, 3)
        assert max(np.linalg.norm(line - p, axis=1).min() for p in before) < 0.0065


def rims(mesh: Mesh):
    return [mesh.vertices[loop] for loop in boundary_loops(mesh)]


def test_colors_keep_their_borders():
    box = fine_box()
    dark = np.abs(box.vertices[:, 0]) < 0.3
    painted = replace(box, colors=np.where(dark[:, None], 40, 200).astype(np.uint8).repeat(3, 1)[:, :3])
    plain, kept = reduce_faces(painted, 0, 0.01, -1.0), reduce_faces(painted, 0, 0.01, 8.0)
    assert len(plain.faces) < len(kept.faces) < 200
    errors = []
    for mesh in (plain, kept):
        _, face, spot = igl.point_mesh_squared_distance(painted.vertices, mesh.vertices, mesh.faces.astype(np.int64))
        places = [np.ascontiguousarray(mesh.vertices[mesh.faces[face, k]]) for k in range(3)]
        shares = igl.barycentric_coordinates(spot, *places)
        shown = (shares[:, :, None] * mesh.colors[mesh.faces[face]]).sum(1)
        errors.append(np.sqrt(((shown - painted.colors) ** 2).mean()))
    assert errors[1] < 8 and errors[0] > 30
    fewer = reduce_faces(painted, 30, 0.01, 8.0)
    assert len(fewer.faces) <= 30 and distances(painted.vertices, fewer).max() < 0.011  # colours give way, not shape


def test_values_and_far_places_survive():
    mesh = ball(subdivisions=4)
    values = {"views": np.arange(len(mesh.vertices), dtype=np.uint8), "height": mesh.vertices[:, 2].astype(np.float32)}
    far = replace(mesh, vertices=mesh.vertices + np.array([1e6, -5e5, 0]), values=values)
    reduced = reduce_faces(far, 500)
    assert np.abs(np.linalg.norm(reduced.vertices - [1e6, -5e5, 0], axis=1) - 1).max() < 0.05
    assert reduced.values["views"].dtype == np.uint8
    assert np.abs(reduced.values["height"] - reduced.vertices[:, 2]).max() < 0.1


def test_bad_meshes_do_not_break_it():
    fin = Mesh(
        np.array([[0.0, 0, 0], [0, 0, 1], [1, 0, 0.5], [-1, 0.5, 0.5], [-1, -0.5, 0.5], [0, 0, 0]]),
        np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4], [0, 5, 2]], np.int32), np.zeros((6, 3), np.uint8),
    )  # fmt: skip
    for tolerance in (1e-3, 10.0):
        result = reduce_faces(fin, 0, tolerance)
        assert 0 < len(result.faces) <= 4 and np.isfinite(result.vertices).all()
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros((0, 3), np.uint8))
    assert reduce_faces(nothing, 5, 0.1) is nothing
    tetrahedron = mesh_of(as_trimesh(ball(subdivisions=1)).convex_hull)
    assert len(reduce_faces(tetrahedron, 1, 10.0).faces) >= 4  # a closed part never vanishes


def test_same_input_same_mesh():
    mesh = noisy(ball(subdivisions=4), 0.01)
    one, two = (reduce_faces(mesh, 700, 0.003, 8.0) for _ in range(2))
    assert np.array_equal(one.vertices, two.vertices) and np.array_equal(one.faces, two.faces)


def test_the_result_does_not_depend_on_the_number_of_threads():
    mesh = noisy(fine_box(6), 1e-3)
    results = []
    for count in (1, 3):
        library.set_threads(count)
        try:
            results.append(reduce_faces(mesh, tolerance=0.02))
        finally:
            library.set_threads(0)
    assert len(mesh.faces) > 2 * SLAB_FACES
    assert np.array_equal(results[0].faces, results[1].faces)
    assert np.array_equal(results[0].vertices, results[1].vertices)


def test_slabs_cost_few_faces(monkeypatch):
    mesh = noisy(fine_box(6), 1e-3)
    sliced = reduce_faces(mesh, tolerance=0.005)
    monkeypatch.setattr(decimate, "MOST_SLABS", 1)
    assert len(sliced.faces) <= 1.2 * len(reduce_faces(mesh, tolerance=0.005).faces) + 10
    assert distances(mesh.vertices, sliced).max() <= 0.005 + 1e-6


def test_progress_grows_and_cancelling_stops():
    shares: list[float] = []
    mesh = fine_box(6)
    reduce_faces(mesh, tolerance=0.01, progress=shares.append)
    assert len(shares) >= 3
    assert shares == sorted(shares)
    assert shares[-1] < 1

    def cancel(share: float) -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        reduce_faces(mesh, tolerance=0.01, progress=cancel)


def folded_area(mesh: Mesh) -> float:
    """Area of the faces of a sheet that look downwards."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(np.clip(-np.cross(b - a, c - a)[:, 2], 0, None).sum() / 2)


@pytest.mark.parametrize("seed", range(3))
def test_what_is_folded_over_within_a_wall_shrinks(seed):
    rng = np.random.default_rng(seed)
    across, along = (axis.ravel() for axis in np.meshgrid(np.arange(60.0), np.arange(60.0)))
    faces = np.array([[i, i + 1, i + 61] for i in range(59 * 60) if i % 60 < 59]
                     + [[i, i + 61, i + 60] for i in range(59 * 60) if i % 60 < 59], np.int32)  # fmt: skip
    inner = (across > 0) & (across < 59) & (along > 0) & (along < 59) & (rng.random(3600) < 0.1)
    flat = np.stack([across, along, np.zeros(3600)], 1)
    flat[inner, :2] += rng.normal(size=(inner.sum(), 2))
    sheet = Mesh(flat, faces, np.zeros((3600, 3), np.uint8))
    reduced = reduce_faces(sheet, tolerance=0.05)
    assert folded_area(sheet) > 20
    assert folded_area(reduced) < 0.05 * folded_area(sheet)
