# SPDX-License-Identifier: GPL-3.0-or-later
"""Planar parts go into their planes, edges become lines, and what stands out or is bent stays."""

import time

import numpy as np
import pytest

from mgf_engine.mesh.planar import flatten, flatten_planes
from mgf_engine.mesh.planar_options import PlanarOptions
from mgf_engine.mesh.plane_detection import Plane
from mgf_engine.model.mesh import Mesh
from tests.support.sheets import NOISE, box, joined, noisy, sheet


def flat(mesh):
    """The flattened mesh, checked for what must always hold."""
    flattened = flatten_planes(mesh, np.ones(len(mesh.vertices), np.float32))
    result, planes = flattened.mesh, flattened.planes
    assert np.isfinite(result.vertices).all()
    assert (result.faces == mesh.faces).all()
    before, after = normals(mesh), normals(result)
    allowed = 1e-6 * np.linalg.norm(before, axis=1)  # faces whose corners all lie on one edge have no area
    turned = (before / np.linalg.norm(before, axis=1)[:, None] * after).sum(1) < -allowed
    against = (planes.normals[planes.label] * after).sum(1) < -allowed if planes else True
    assert not (turned & against).any(), "a face turned over"
    return result


def normals(mesh):
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def test_noisy_box_becomes_flat_with_straight_edges():
    exact = box(60, 45, 30)
    result = flat(noisy(exact))
    sides = np.array([60, 45, 30])
    on = (exact.vertices == 0) | (exact.vertices == sides)  # the sides that each vertex lies in
    off = result.vertices - exact.vertices
    for axis in range(3):
        for side in (exact.vertices[:, axis] == 0, exact.vertices[:, axis] == sides[axis]):
            assert rms(off[side, axis]) < 0.4 * NOISE
    edge = on.sum(1) >= 2
    assert np.percentile(np.abs(off[on & edge[:, None]]), 95) < 0.5 * NOISE
    turned = normals(result) / np.linalg.norm(normals(result), axis=1, keepdims=True)
    assert np.percentile(np.abs(turned).max(1), 10) > np.cos(np.radians(2))


def test_rounded_edges_become_sharp():
    """Smoothing rounds an edge by half a pixel; the vertices on it go back onto the line."""
    exact = box(60, 45, 30)
    result = flat(noisy(Mesh(exact.adjacency.smooth(exact.vertices, np.zeros(len(exact.vertices), bool)),
                             exact.faces, exact.colors), 0.05))  # fmt: skip
    on = (exact.vertices == 0) | (exact.vertices == np.array([60, 45, 30]))
    crease = on & (on.sum(1) == 2)[:, None]
    assert np.median(np.abs((result.vertices - exact.vertices)[crease])) < 0.05


def relief(u, v, height):
    return np.where((np.abs(u - 40) < 10) & (np.abs(v - 40) < 10), height, 0.0)


def test_what_stands_out_by_four_sigma_stays():
    line = np.arange(0, 81.0)
    wall = noisy(joined(sheet(line, line, lambda u, v: (u, v, relief(u, v, 4 * NOISE)))))
    result = flat(wall)
    inner = relief(*wall.vertices[:, :2].T, 1.0) > 0
    inner &= (np.abs(wall.vertices[:, :2] - 40) < 9).all(1)
    assert abs(result.vertices[inner, 2].mean() - 4 * NOISE) < 0.5 * NOISE
    far = (np.abs(wall.vertices[:, :2] - 40) > 12).any(1)
    assert rms(result.vertices[far, 2]) < 0.3 * NOISE


@pytest.mark.parametrize("radius", [12.0, 40.0, 150.0])
def test_cylinder_stays_round(radius):
    around, up = np.linspace(0, 2 * np.pi, round(2 * np.pi * radius / 1.5) + 1), np.arange(0, 60, 1.5)
    place = lambda u, v: (radius * np.cos(u), radius * np.sin(u), v)  # noqa: E731
    rough = noisy(joined(sheet(around, up, place)))
    result = flat(rough)
    before, after = (np.linalg.norm(mesh.vertices[:, :2], axis=1) - radius for mesh in (rough, result))
    assert rms(after) < 1.1 * rms(before)
    assert np.abs(after).max() < 5 * NOISE


@pytest.mark.parametrize("sag", [0.5, 1.0, 3.0])
def test_gently_curved_wall_stays_curved(sag):
    line = np.arange(0, 121.0, 1.5)
    truth = lambda u: sag * (1 - ((u - 60) / 60) ** 2)  # noqa: E731
    rough = noisy(joined(sheet(line, line[:40], lambda u, v: (u, v, truth(u)))), 0.1)
    result = flat(rough)
    assert rms(result.vertices[:, 2] - truth(result.vertices[:, 0])) < 0.15
    assert np.abs(result.vertices[:, 2] - truth(result.vertices[:, 0])).max() < 0.6


def test_slow_waves_of_stereo_do_not_keep_a_wall_from_being_flat():
    """Depths by stereo are wrong together over ten pixels and more; a wall is as flat there as anywhere."""
    line = np.arange(0, 121.0, 1.5)
    waves = lambda u, v: 0.9 * np.sin(u / 7) * np.cos(v / 6)  # noqa: E731
    result = flat(noisy(joined(sheet(line, line[:60], lambda u, v: (u, v, waves(u, v)))), 0.1))
    inside = (result.vertices[:, :2] > 3).all(1) & (result.vertices[:, :2] < (115, 83)).all(1)
    assert rms(result.vertices[inside, 2]) < 0.1 < 0.4 < rms(waves(*result.vertices[inside, :2].T))


def test_a_long_wall_that_bows_by_half_a_pixel_becomes_flat():
    """Errors of cameras bend a wall as long as a photo by that much, however smooth its surface is."""
    line = np.arange(0, 421.0, 3.0)
    bow = lambda u: 0.6 * (1 - ((u - 210) / 210) ** 2)  # noqa: E731
    wall = noisy(joined(sheet(line, line[:100], lambda u, v: (u, v, bow(u)))), 0.05)
    assert flatten_planes(wall, np.ones(len(wall.vertices)), PlanarOptions(bow_share=0.0)).planes is None
    assert rms(flat(wall).vertices[:, 2] - bow(line).mean()) < 0.05


def sinking_wall():
    """A plain wall that sinks towards its windows: most of it leans."""
    line = np.arange(0, 161.0, 1.5)
    sink = lambda u, v: 4.0 * np.exp(-(((u % 54 - 27) / 13) ** 2) - ((v - 40) / 18) ** 2)  # noqa: E731
    return noisy(joined(sheet(line, line[:54], lambda u, v: (u, v, -sink(u, v)))), 0.05)


def test_a_plane_through_edges_replaces_those_that_lean():
    wall = sinking_wall()
    ones, known = np.ones(len(wall.vertices)), Plane(np.array([0, 0, -1.0]), 0.0)  # edges do not tell its side
    alone, found = flatten_planes(wall, ones).planes, flatten_planes(wall, ones, known=[known]).planes
    assert alone is not None and found is not None
    assert alone.offsets[alone.area.argmax()] < -1
    largest = found.area.argmax()
    assert found.normals[largest, 2] > np.cos(np.radians(0.3)) and abs(found.offsets[largest]) < 0.15
    assert found.area[largest] > alone.area.max() and found.area.min() >= PlanarOptions().least_area
    assert set(np.unique(found.label)) == {-1, *range(len(found.area))}


def test_a_known_plane_between_the_two_of_one_wall_is_left_out():
    line = np.arange(0, 121.0, 1.5)
    wall = noisy(joined(sheet(line, line[:40], lambda u, v: (u, v, np.where(u > 60, 0.9, -0.9)))), 0.1)
    ones, between = np.ones(len(wall.vertices)), Plane(np.array([0, 0, 1.0]), 0.0)
    alone, found = flatten_planes(wall, ones).planes, flatten_planes(wall, ones, known=[between]).planes
    assert alone is not None and found is not None
    np.testing.assert_array_equal(found.offsets, alone.offsets)


def test_a_known_plane_does_not_flatten_a_vault():
    angle, along = np.arange(0.4, 2.75, 0.02), np.arange(0, 90, 2.0)
    vault = noisy(joined(sheet(along, angle, lambda u, v: (u, -60 * np.cos(v), 60 * np.sin(v)))), 0.05)
    tangent = [Plane(np.array([0, -np.cos(a), np.sin(a)]), 60.0 - off) for a in (0.9, 1.57) for off in (0.0, 0.5)]
    assert flatten_planes(vault, np.ones(len(vault.vertices)), known=tangent).planes is None


def test_a_wall_on_both_sides_of_a_pipe_is_one_plane():
    """Stereo errs by a fraction of a pixel from one side to the other; two planes would leave a step."""
    line = np.arange(0, 121.0, 1.5)
    pipe = lambda u: np.where(np.abs(u - 60) < 2, 5.0, 0.0)  # noqa: E731
    wall = noisy(joined(sheet(line, line[:40], lambda u, v: (u, v, pipe(u) + np.where(u > 60, 0.4, 0.0)))), 0.2)
    ones = np.ones(len(wall.vertices))
    apart = flatten_planes(wall, ones, PlanarOptions(merged_distance=0.0)).planes
    planes = flatten_planes(wall, ones).planes
    assert apart is not None and planes is not None
    assert len(apart.normals) == 2 and len(planes.normals) == 1
    assert (planes.label >= 0).sum() == (apart.label >= 0).sum()


def test_a_rough_wall_beside_a_smooth_vault_becomes_flat():
    """Every place of the vault is more even than the wall, and there are more of them than are tried."""
    angle, along, line = np.arange(0.5, 2.6, 0.02), np.arange(0, 240, 2.5), np.arange(0, 61, 1.5)
    vault = sheet(along, angle, lambda u, v: (u, -150 * np.cos(v), 150 * np.sin(v)))
    wall = sheet(line, line, lambda u, v: (u, v, np.full(len(u), -50.0)))
    rough = noisy(joined(wall), 0.3)
    away = rough.vertices.mean(0)
    both = joined((rough.vertices, rough.faces), vault)
    result = flat(both)
    mine = both.vertices[:, 2] < 0
    assert np.isclose(both.vertices[mine].mean(0), away, atol=1e-3).all()
    assert rms(result.vertices[mine, 2] + 50) < 0.1 < 0.25 < rms(both.vertices[mine, 2] + 50)
    assert rms(np.hypot(*result.vertices[~mine, 1:].T) - 150) < 0.1, "the vault stays round"


def test_thin_bar_keeps_its_thickness():
    exact = box(3, 3, 200, 1.0)
    rough = noisy(exact, 0.15)
    result = flat(rough)
    for axis in range(2):
        high, low = exact.vertices[:, axis] == 3, exact.vertices[:, axis] == 0
        thickness = result.vertices[high, axis].mean() - result.vertices[low, axis].mean()
        assert abs(thickness - 3) < 0.1


def test_step_between_two_levels_stays():
    """A ledge of two pixels: its levels become flat, the riser stays between them."""
    exact = joined(
        sheet(np.arange(0, 41.0), np.arange(0, 61.0), lambda u, v: (u, v, 0 * u)),
        sheet(np.arange(0, 3.0), np.arange(0, 61.0), lambda u, v: (0 * u + 40, v, u)),
        sheet(np.arange(40, 81.0), np.arange(0, 61.0), lambda u, v: (u, v, 0 * u + 2)),
    )
    result = flat(noisy(exact))
    for level in (0.0, 2.0):
        there = (exact.vertices[:, 2] == level) & (np.abs(exact.vertices[:, 0] - 40) > 3)
        assert rms(result.vertices[there, 2] - level) < 0.3 * NOISE


def test_without_planes_the_mesh_is_returned_as_it_is():
    empty = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros((0, 3), np.uint8))
    assert flatten(empty, np.zeros(0, np.float32)) is empty
    small = box(8, 8, 8)
    assert flatten(small, np.ones(len(small.vertices))) is small
    rough = noisy(box(60, 45, 30), 3.0)
    assert np.array_equal(flatten(rough, np.ones(len(rough.vertices))).vertices, rough.vertices)
    assert flatten(rough, np.zeros(len(rough.vertices))) is rough  # no view tells how large a pixel is


def test_degenerate_faces_do_no_harm():
    mesh = box(60, 45, 30)
    vertices = np.concatenate([mesh.vertices, mesh.vertices[:1], mesh.vertices[:1]])
    last = len(vertices) - 1
    faces = np.concatenate([mesh.faces, [[0, last - 1, last]]]).astype(np.int32)
    rough = Mesh(vertices, faces, np.zeros((len(vertices), 3), np.uint8))
    result = flatten(rough, np.ones(len(vertices)))
    assert np.isfinite(result.vertices).all()


def test_size_of_the_scene_does_not_matter():
    rough = noisy(box(60, 45, 30))
    small = Mesh(rough.vertices * 1e-4, rough.faces, rough.colors)
    result = flatten(small, np.full(len(small.vertices), 1e-4))
    assert np.allclose(result.vertices * 1e4, flatten(rough, np.ones(len(rough.vertices))).vertices, atol=1e-6)


def test_takes_little_time():
    rough = noisy(box(200, 150, 100, 1.0))
    assert len(rough.faces) > 200_000
    start = time.process_time()
    flatten(rough, np.ones(len(rough.vertices)))
    assert time.process_time() - start < 6.0  # about 1.5 seconds on one core
