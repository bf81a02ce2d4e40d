# SPDX-License-Identifier: GPL-3.0-or-later
"""Planes of meshes whose planes are known, and the order in which they are tried."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from mgf_engine.mesh.planar_options import PlanarOptions
from mgf_engine.mesh.plane_detection import MeshFaces, Plane, _by_turns, _refit, planes_of
from mgf_engine.model.mesh import Mesh


def box(*size: float) -> Mesh:
    """A box around the origin of two triangles on each side."""
    made = trimesh.creation.box(size)
    vertices = np.asarray(made.vertices, np.float64)
    return Mesh(vertices, np.asarray(made.faces, np.int32), np.zeros((len(vertices), 3), np.uint8))


def test_a_mesh_smaller_than_the_smallest_plane_has_none() -> None:
    planes = planes_of(box(10, 10, 10), 1.0)
    assert len(planes.normals) == 0 and (planes.label == -1).all()


@pytest.mark.parametrize("pixel", [1.0, 0.02])
def test_a_box_has_six_planes(pixel: float) -> None:
    size = np.array([60.0, 40.0, 30.0]) * pixel
    mesh = box(*size)
    planes = planes_of(mesh, pixel)
    assert len(planes.normals) == 6 and set(planes.label.tolist()) == set(range(6))
    axis = np.abs(planes.normals).argmax(1)
    np.testing.assert_allclose(np.abs(planes.normals), np.eye(3)[axis], atol=1e-9)
    np.testing.assert_allclose(planes.offsets, size[axis] / 2, rtol=1e-9)
    assert planes.noise == pytest.approx(0.0, abs=1e-6)
    for face, label in zip(mesh.faces, planes.label, strict=True):
        assert planes.distances(mesh.vertices[face], np.full(3, label)) == pytest.approx(0.0, abs=1e-9)


def test_distances_are_signed_by_the_outside() -> None:
    planes = planes_of(box(60, 40, 30), 1.0)
    top = np.array([int(planes.normals[:, 2].argmax())])
    assert planes.distances(np.array([[3.0, 2.0, 20.0]]), top) == pytest.approx(5.0)
    assert planes.distances(np.array([[3.0, 2.0, 0.0]]), top) == pytest.approx(-15.0)


def test_the_best_of_each_coarse_cell_goes_before_the_second_of_any() -> None:
    cell, score = np.array([0, 0, 1, 1, 0]), np.array([5.0, 4.0, 3.0, 2.0, 1.0])
    assert _by_turns(cell, score).tolist() == [0, 2, 1, 3, 4]
    assert _by_turns(cell[:0], score[:0]).tolist() == []


def test_faces_near_the_edge_of_the_band_hardly_move_a_plane() -> None:
    """Three faces of ten lie 3 px before the others, in a band of 4 px: weights of 0.27 against 0.99."""
    x, y = np.meshgrid(np.arange(30.0), np.arange(30.0))
    z = np.where((x + 3 * y).ravel() % 10 < 3, 3.0, 0.0)
    centre, one = np.stack([x.ravel(), y.ravel(), z], 1), np.ones(x.size)
    normals = np.tile([0.0, 0.0, 1.0], (x.size, 1))
    faces = MeshFaces(box(1, 1, 1), centre, normals, one, one, np.zeros((2, 0), np.int64))
    found = _refit(faces, np.arange(x.size), Plane(normals[0], 0.0), PlanarOptions(band=4.0))
    assert found is not None
    normal, offset = found
    assert normal == pytest.approx([0, 0, 1], abs=1e-2)
    assert offset - normal @ [14.5, 14.5, 0] == pytest.approx(0.312, abs=0.02)
    assert _refit(faces, np.arange(10), Plane(normals[0], 0.0), PlanarOptions(band=4.0)) is None  # too small an area
