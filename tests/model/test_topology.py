# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernels that tell what hangs together, against references, on clean meshes and on soups of faces."""

from __future__ import annotations

from collections.abc import Iterator

import igl
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from support.analytic import ball, cuboid

from mgf_engine.geometry import clean
from mgf_engine.geometry.morton import along_curve, arrange, cells_of, morton
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.topology import Adjacency
from mgf_engine.native import library


@pytest.fixture(params=[1, 3], autouse=True)
def threads(request: pytest.FixtureRequest) -> Iterator[None]:
    library.set_threads(request.param)
    yield
    library.set_threads(0)


def mesh_of(vertices: NDArray[np.float64], faces: NDArray[np.integer]) -> Mesh:
    return Mesh(vertices, np.asarray(faces, np.int32), np.zeros((len(vertices), 3), np.uint8))


def soup(seed: int) -> Mesh:
    """Random faces between few vertices: edges of many faces, of one, and run along twice in one direction."""
    generator = np.random.default_rng(seed)
    faces = generator.integers(0, 40, (60, 3))
    faces = faces[(np.diff(np.sort(faces, 1), axis=1) > 0).all(1)]
    return clean.weld(mesh_of(generator.normal(size=(40, 3)), faces))


def touching() -> Mesh:
    """Two boxes that share an edge, and a third one that touches a corner; oriented outward."""
    box = cuboid((1.0, 1.0, 1.0))
    moved = [box.vertices + offset for offset in ([0, 0, 0], [2, 2, 0], [-2, -2, -2])]
    faces = np.concatenate([box.faces + k * len(box.vertices) for k in range(3)])
    return clean.weld(mesh_of(np.concatenate(moved), faces))


MESHES = [ball(subdivisions=3), touching(), soup(1), soup(2)]


def edge_keys(faces: NDArray[np.int32]) -> NDArray[np.int64]:
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], -1).reshape(-1, 2)
    return np.asarray(ends.min(1).astype(np.int64) << 32 | ends.max(1))


def same_groups(a: NDArray[np.integer], b: NDArray[np.integer]) -> bool:
    pairs = {(int(x), int(y)) for x, y in zip(a.ravel(), b.ravel(), strict=True)}
    return len(pairs) == len(np.unique(a)) == len(np.unique(b))


@pytest.mark.parametrize("mesh", MESHES)
def test_corners_lie_around_their_vertices(mesh: Mesh) -> None:
    around = mesh.adjacency
    assert np.array_equal(around.corner, np.argsort(mesh.faces.ravel(), kind="stable"))
    assert np.array_equal(np.diff(around.start), np.bincount(mesh.faces.ravel(), minlength=len(mesh.vertices)))


@pytest.mark.parametrize("mesh", MESHES)
def test_parts_hang_together_by_edges(mesh: Mesh) -> None:
    key = edge_keys(mesh.faces)
    face, edge = np.repeat(np.arange(len(mesh.faces)), 3), np.unique(key, return_inverse=True)[1]
    graph = coo_matrix((np.ones(len(face)), (face, len(mesh.faces) + edge)), shape=(4 * len(face),) * 2)
    expected = connected_components(graph, directed=False)[1][: len(mesh.faces)]
    found = clean.parts(mesh)
    assert same_groups(found, expected)
    assert np.array_equal(np.unique(found, return_index=True)[1], np.sort(np.unique(expected, return_index=True)[1]))


@pytest.mark.parametrize("mesh", MESHES)
def test_open_edges_have_one_face(mesh: Mesh) -> None:
    key = edge_keys(mesh.faces)
    alone = (np.unique(key, return_counts=True)[1] == 1)[np.unique(key, return_inverse=True)[1]]
    assert np.array_equal(mesh.adjacency.open_edges().ravel(), alone)


@pytest.mark.parametrize("mesh", MESHES)
def test_split_meshes_are_manifold_and_look_the_same(mesh: Mesh) -> None:
    apart = clean.split_nonmanifold(mesh)
    assert np.abs(apart.vertices[apart.faces] - mesh.vertices[mesh.faces]).max() < 0.05  # a hundredth of an edge
    assert np.unique(edge_keys(apart.faces), return_counts=True)[1].max() <= 2
    ends = np.stack([apart.faces, np.roll(apart.faces, -1, axis=1)], -1).reshape(-1, 2)
    assert len(np.unique(ends, axis=0)) == len(ends)  # neighbours run along their edge in opposite directions
    assert (apart.adjacency.fans()[1] == 1).all()


@pytest.mark.parametrize("mesh", [ball(subdivisions=3), touching()])
def test_split_equals_that_of_libigl(mesh: Mesh) -> None:
    expected = igl.split_nonmanifold(mesh.faces.astype(np.int64))[0]
    assert same_groups(clean.split_nonmanifold(mesh).faces, expected)


def test_boxes_that_touch_come_apart() -> None:
    assert len(touching().vertices) == 3 * 8 - 3
    assert len(clean.split_nonmanifold(touching()).vertices) == 3 * 8


@pytest.mark.parametrize("mesh", MESHES)
def test_vertices_go_half_way_to_the_mean_of_their_neighbours(mesh: Mesh) -> None:
    fixed = np.arange(len(mesh.vertices)) % 5 == 0
    moved = mesh.adjacency.smooth(mesh.vertices, fixed)
    keys = np.unique(edge_keys(mesh.faces))
    for v, place in enumerate(mesh.vertices):
        near = [int(b if a == v else a) for a, b in zip(keys >> 32, keys & 0xFFFFFFFF, strict=True) if v in (a, b)][:99]
        expected = place if fixed[v] or not near else 0.5 * (place + mesh.vertices[near].mean(0))
        np.testing.assert_allclose(moved[v], expected, atol=1e-12)
        if v > 150:
            break


@pytest.mark.parametrize("mesh", MESHES)
def test_normals_of_vertices_are_sums_over_faces(mesh: Mesh) -> None:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    expected = np.zeros_like(mesh.vertices)
    np.add.at(expected, mesh.faces, np.cross(b - a, c - a)[:, None, :])
    np.testing.assert_allclose(mesh.adjacency.vertex_normals(mesh.vertices), expected, atol=1e-12)


def test_no_faces() -> None:
    nothing = Adjacency.of(np.zeros((0, 3), np.int32), 4)
    assert len(nothing.parts()) == 0 and (nothing.fans()[1] == 0).all() and nothing.open_edges().shape == (0, 3)


def test_cells_get_places_of_their_own_and_neighbours_are_near() -> None:
    cells = np.random.default_rng(0).integers(0, 2**21, (200, 3))
    expected = [sum((int(c[a]) >> b & 1) << (3 * b + a) for a in range(3) for b in range(21)) for c in cells]
    assert morton(cells).tolist() == expected
    grid = np.stack(np.meshgrid(*[np.arange(8.0)] * 3), -1).reshape(-1, 3)
    ordered = grid[np.argsort(morton(cells_of(grid)))]
    assert np.linalg.norm(np.diff(ordered, axis=0), axis=1).mean() < 1.6


def test_points_along_the_curve_have_their_neighbours_near() -> None:
    points = np.random.default_rng(0).normal(size=(2000, 3))
    order = along_curve(points)
    assert np.array_equal(np.sort(order), np.arange(2000)) and len(along_curve(points[:0])) == 0
    apart = [np.linalg.norm(np.diff(p, axis=0), axis=1).mean() for p in (points[order], points)]
    assert apart[0] < 0.4 * apart[1]
    assert np.array_equal(along_curve(np.zeros((5, 3))), np.arange(5))
    points[7] = np.nan, np.inf, 0.0
    assert np.array_equal(np.sort(along_curve(points)), np.arange(2000))


def test_order_by_key_then_by_the_others() -> None:
    generator = np.random.default_rng(0)
    key, minor = generator.integers(0, 50, 300).astype(np.uint64), generator.integers(0, 4, (2, 300))
    order, new = arrange(key, *minor)
    assert np.array_equal(order, np.lexsort([np.arange(300), minor[1], minor[0], key]))
    rows = np.stack([key.astype(np.int64), *minor], 1)[order]
    assert np.array_equal(new, np.r_[True, (rows[1:] != rows[:-1]).any(1)])


def test_neighbours_are_the_other_ends_of_the_edges_around_a_vertex():
    faces = np.array([[0, 1, 2], [2, 1, 3]], np.int32)
    start, neighbour = Adjacency.of(faces, 5).neighbours()
    around = [rows.tolist() for rows in np.split(neighbour, start[1:-1])]
    assert around == [[1, 2], [0, 2, 3], [0, 1, 3], [1, 2], []]
    assert [len(a) for a in Adjacency.of(np.zeros((0, 3), np.int32), 0).neighbours()] == [1, 0]
