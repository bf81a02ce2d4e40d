# SPDX-License-Identifier: GPL-3.0-or-later
"""Flat parts lose vertices; edges, thin bars, handles and holes keep theirs. The kernel against a reference."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from support.analytic import as_trimesh, ball, camera, cuboid, mesh_of, ring

from mgf_engine.evaluation.surfaces import Surface
from mgf_engine.geometry.clean import weld
from mgf_engine.mesh.ground_pixels import nearest_pixels
from mgf_engine.mesh.planar_clustering import PlanarClusteringOptions, merge_cells, merge_flat
from mgf_engine.model.mesh import Mesh
from mgf_engine.native.library import call


def fine(mesh: Mesh, edge: float, noise: float = 0.0) -> Mesh:
    """The mesh cut into faces with edges no longer than ``edge``, its vertices off by about ``noise``."""
    mesh = mesh_of(as_trimesh(mesh).subdivide_to_size(edge))
    offset = np.random.default_rng(0).normal(0, noise, mesh.vertices.shape) if noise else 0.0
    return Mesh(mesh.vertices + offset, mesh.faces, mesh.colors)


def plain_groups(mesh: Mesh, cell: NDArray[np.integer], tolerance: float, even: float) -> list[set[int]]:
    """Which vertices merge_flat.c makes one, where no face would turn over; float64, group by group."""
    ends = np.concatenate([mesh.faces[:, [k, (k + 1) % 3]] for k in range(3)])
    ends = ends[cell[ends[:, 0]] == cell[ends[:, 1]]]
    count = len(mesh.vertices)
    graph = coo_matrix((np.ones(len(ends)), ends.T), shape=(count, count))
    label = connected_components(graph, directed=False)[1]
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    result = []
    for group in range(label.max() + 1):
        inside = label[mesh.faces] == group
        edges = {frozenset(e) for e in ends[label[ends[:, 0]] == group].tolist()}
        members = np.flatnonzero(label == group)
        disc = len(members) - len(edges) + inside.all(1).sum() == 1
        weights = inside.sum(1)[:, None]
        total = (normals * weights).sum(0)
        mean = np.linalg.norm(total) / (np.linalg.norm(normals, axis=1, keepdims=True) * weights).sum()
        local = mesh.vertices[members] - mesh.vertices[members].mean(0)
        off = np.sqrt(((local @ (total / np.linalg.norm(total))) ** 2).mean())
        if disc and mean >= even and off <= tolerance and len(members) > 1:
            result.append(set(members.tolist()))
    return result


def grid(mesh: Mesh, side: float) -> NDArray[np.int32]:
    corner = np.floor((mesh.vertices - mesh.vertices.min(0)) / side + 0.3)
    return np.unique(corner, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int32)


def kernel(mesh: Mesh, cell: NDArray[np.int32], tolerance: float) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    at, into = mesh.vertices.copy(), np.empty(len(mesh.vertices), np.int32)
    allowed = np.full(len(at), tolerance, np.float32)
    assert (
        call(
            "mgf_merge_flat",
            len(at),
            len(mesh.faces),
            at,
            mesh.faces,
            cell,
            allowed,
            PlanarClusteringOptions.even,
            into,
        )
        == 0
    )
    return at, into


@pytest.mark.parametrize(
    "mesh", [fine(cuboid(), 0.06, 0.002), ball(subdivisions=5), fine(cuboid((1, 0.03, 0.03)), 0.02)]
)
@pytest.mark.parametrize("side", [0.1, 0.25])
def test_the_kernel_merges_what_its_plain_reference_does(mesh: Mesh, side: float) -> None:
    cell = grid(mesh, side)
    at, into = kernel(mesh, cell, 0.004)
    found = [set(np.flatnonzero(into == first).tolist()) for first in np.flatnonzero(np.bincount(into) > 1)]
    expected = plain_groups(mesh, cell, 0.004, PlanarClusteringOptions.even)
    folded = [g for g in expected if g not in found]
    assert all(g in expected for g in found) and len(folded) <= 0.1 * len(expected)
    for group in found:
        members = sorted(group)
        assert into[members[0]] == members[0] and np.allclose(at[members], mesh.vertices[members].mean(0))
    alone = np.bincount(into, minlength=len(into))[into] == 1
    assert np.array_equal(at[alone], mesh.vertices[alone]) and np.array_equal(into[alone], np.flatnonzero(alone))


def test_a_box_keeps_its_shape_with_a_third_of_the_vertices() -> None:
    pixel = nearest_pixels(np.zeros((1, 3)), ring())[0]
    mesh = fine(cuboid(), 0.7 * pixel, 0.03 * pixel)
    merged = merge_flat(mesh, ring())
    assert len(merged.vertices) < 0.4 * len(mesh.vertices)
    shape = as_trimesh(merged)
    assert shape.is_watertight and shape.is_winding_consistent and shape.euler_number == 2
    distance = Surface(merged.vertices, merged.faces).distances(mesh.vertices)
    assert distance.max() < 3 * PlanarClusteringOptions.tolerance * pixel and distance.mean() < 0.1 * pixel


def test_a_bar_thinner_than_a_cell_keeps_every_vertex() -> None:
    pixel = nearest_pixels(np.zeros((1, 3)), ring())[0]
    mesh = fine(cuboid((1.0, 0.4 * pixel, 0.4 * pixel)), 0.5 * pixel)
    merged = merge_flat(mesh, ring())
    assert as_trimesh(merged).is_watertight and as_trimesh(merged).euler_number == 2
    assert as_trimesh(merged).volume == pytest.approx(as_trimesh(mesh).volume, rel=0.02)


def test_nothing_is_pinched_where_a_wall_has_many_small_windows() -> None:
    """Cells around holes of about their size: merged as they come they would share rims of two edges."""
    side = np.linspace(-1, 1, 121)
    x, y = np.meshgrid(side, side)
    at = np.c_[x.ravel(), y.ravel(), 0 * x.ravel()]
    index = np.arange(len(at)).reshape(121, 121)
    a, b, c, d = index[:-1, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, 1:].ravel(), index[1:, :-1].ravel()
    faces = np.concatenate([np.c_[a, b, c], np.c_[a, c, d]])
    hole = np.random.default_rng(3).random(len(a)) < 0.12
    mesh = weld(Mesh(at, faces[~np.r_[hole, hole]].astype(np.int32), np.zeros((len(at), 3), np.uint8)))
    merged = merge_cells(mesh, grid(mesh, 0.06), np.full(len(mesh.vertices), 0.01))
    assert len(merged.vertices) < len(mesh.vertices)
    assert Surface(merged.vertices, merged.faces).hygiene().non_manifold_edges == 0
    holes = Surface(mesh.vertices, mesh.faces).hygiene().holes
    assert Surface(merged.vertices, merged.faces).hygiene().holes == holes


def test_cells_are_as_large_as_the_pixels_of_the_nearest_photo() -> None:
    wall = fine(cuboid((1.0, 1.0, 0.01)), 0.02)
    near, far = (merge_flat(wall, [camera((0.0, -0.1, z))]) for z in (1.0, 4.0))
    assert len(far.vertices) < 0.5 * len(near.vertices)
    assert len(merge_flat(wall, [camera((0.0, -0.1, z)) for z in (1.0, 4.0)]).vertices) == len(near.vertices)


def test_a_camera_on_the_wall_and_a_mesh_of_nothing_do_no_harm() -> None:
    wall = fine(cuboid((1.0, 1.0, 0.01)), 0.1)
    merged = merge_flat(wall, [camera(wall.vertices[0] + 1e-12, (0.0, 0.1, 3.0))])
    assert as_trimesh(merged).is_watertight
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros((0, 3), np.uint8))
    assert len(merge_flat(nothing, ring()).faces) == 0
