# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

import itertools

import numpy as np
import pytest
from support.analytic import as_trimesh

from mgf_engine.geometry.delaunay import delaunay
from mgf_engine.mesh.isosurface import FREE, INVALID, NEAR_ENOUGH, SOLID, find_level, march
from mgf_engine.model.mesh import Mesh

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])  # positive volume


def cloud(count=3000, seed=0):
    return np.random.default_rng(seed).uniform(-1.5, 1.5, (count, 3))


def surface(points, state, tetrahedra=None, inside=None):
    crossing = march(delaunay(points) if tetrahedra is None else tetrahedra, state, points)
    solid, free = points[crossing.edges[:, 0]], points[crossing.edges[:, 1]]
    vertices = 0.5 * (solid + free)
    if inside:
        vertices = find_level(solid, free, lambda p, share: np.where(inside(p), -np.inf, np.inf), 12)
    return Mesh(vertices, crossing.faces, np.zeros((len(vertices), 3), np.uint8)), crossing


@pytest.mark.parametrize("pattern", list(itertools.product((FREE, SOLID), repeat=4)))
@pytest.mark.parametrize("order", [(0, 1, 2, 3), (1, 2, 0, 3), (3, 2, 1, 0)])  # even: the volume stays positive
def test_every_pattern_of_one_tetrahedron_faces_the_free_side(pattern, order):
    state, points = np.array(pattern, np.uint8), CORNERS
    mesh, crossing = surface(points, state, np.array([order], np.int32))
    solid = int((state == SOLID).sum())
    assert len(mesh.faces) == {0: 0, 1: 1, 2: 2, 3: 1, 4: 0}[solid]
    if len(mesh.faces) == 0:
        return
    assert (state[crossing.edges[:, 0]] == SOLID).all() and (state[crossing.edges[:, 1]] == FREE).all()
    outward = points[state == FREE].mean(0) - points[state == SOLID].mean(0)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    assert (np.cross(b - a, c - a) @ outward > 0).all()


def test_sphere_is_closed_outward_and_exact():
    points = cloud()

    def inside(p):
        return np.linalg.norm(p, axis=1) < 1

    mesh, _ = surface(points, np.where(inside(points), SOLID, FREE).astype(np.uint8), inside=inside)
    shape = as_trimesh(mesh)
    assert shape.is_watertight and shape.is_winding_consistent
    assert 0.9 < shape.volume / (4 / 3 * np.pi) < 1.0  # positive: outward; chords lie inside
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - 1).max() < 2.0**-12 * 1.0


def test_hollow_shell_has_an_outer_and_an_inner_surface():
    points = cloud(8000)
    radius = np.linalg.norm(points, axis=1)
    mesh, _ = surface(points, ((radius < 1.2) & (radius > 0.5)).astype(np.uint8))
    shape = as_trimesh(mesh)
    assert shape.is_watertight and shape.body_count == 2
    assert sorted(np.sign(part.volume) for part in shape.split()) == [-1, 1]


def test_invalid_points_leave_a_hole_not_a_wall():
    points = cloud()
    state = np.where(np.linalg.norm(points, axis=1) < 1, SOLID, FREE).astype(np.uint8)
    state[points[:, 2] < -0.3] = INVALID
    mesh, crossing = surface(points, state)
    assert not as_trimesh(mesh).is_watertight
    assert (state[crossing.edges] != INVALID).all()
    assert mesh.vertices[mesh.faces].mean(1)[:, 2].min() > -0.3


@pytest.mark.parametrize("value", [FREE, SOLID, INVALID])
def test_one_state_everywhere_has_no_surface(value):
    points = cloud(50)
    mesh, _ = surface(points, np.full(50, value, np.uint8))
    assert len(mesh.faces) == 0 and len(mesh.vertices) == 0


def segments(count=100):
    """Segments along x from 0 to 1, whose y is their number, and where the level lies on each."""
    number = np.arange(count)
    border = np.random.default_rng(0).uniform(0.05, 0.95, count)
    return np.c_[0 * number, number, 0 * number].astype(float), np.c_[0 * number + 1, number, 0 * number], border


def behind(points, border):
    """How far points on those segments lie behind the level."""
    return points[:, 0] - border[points[:, 1].astype(int)]


@pytest.mark.parametrize("far", [1.0, 7.0, np.inf])
def test_where_only_the_sign_is_known_the_error_halves_each_step(far):
    solid, free, border = segments()
    for steps in (0, 3, 8):
        found = find_level(solid, free, lambda p, share: np.where(behind(p, border) < 0, -far, far), steps)
        assert np.abs(behind(found, border)).max() <= 0.5 ** (steps + 1)


@pytest.mark.parametrize("bent", [0.0, 2.0])
def test_known_distances_find_the_level_with_few_points(bent):
    solid, free, border = segments()
    asked = []

    def signed(points, share):
        asked.append(len(points))
        off = 4 * behind(points, border)
        return np.clip(off + bent * off**2 * np.sign(off), -1, 1)

    found = find_level(solid, free, signed, 8)
    assert np.abs(behind(found, border)).max() <= NEAR_ENOUGH / 4
    assert sum(asked) < 5 * len(border)  # who has found it is not asked again


@pytest.mark.parametrize("beyond", [np.inf, np.nan])
def test_a_jump_is_found_too_and_what_nobody_knows_is_not_solid(beyond):
    solid, free, border = segments()
    found = find_level(solid, free, lambda p, share: np.where(behind(p, border) < 0, -0.3, beyond), 12)
    assert np.abs(behind(found, border)).max() <= 2.0**-12
