# SPDX-License-Identifier: GPL-3.0-or-later
"""Openings in the walls of a mesh: found by their depth, once each, with their edges where the photos have them."""

from dataclasses import replace

import numpy as np
import pytest

from mgf_engine.mesh.cut_openings import cut_openings
from mgf_engine.mesh.planar import flatten_planes
from mgf_engine.mesh.wall_openings import MeshOpeningOptions, edge_photos, find_wall_openings
from mgf_engine.model.mesh import Mesh
from mgf_engine.openings.arches import arch_drop
from mgf_engine.openings.detection import OpeningDetectionOptions
from tests.mesh.test_cut_openings import BOX, arched, sloped
from tests.support.wall_photos import cameras

UP = np.array([0.0, 1.0, 0.0])
OTHER = np.array([100.0, 95.1, 130.0, 55.2])


def painted(box, rise=0.0):
    """Photos of a pane in a wall: dark where an opening's place on z = 0 is seen, whatever the mesh is."""

    def photo(number):
        view = cameras()[number]
        grid = np.stack(np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5), -1).reshape(-1, 2)
        ray = view.unproject(grid, np.ones(len(grid))) - view.centre
        at = view.centre - ray * (view.centre[2] / ray[:, 2])[:, None]
        left, top, right, bottom = box
        inside = (at[:, 0] > left) & (at[:, 0] < right) & (at[:, 1] > bottom)
        inside &= at[:, 1] < top - arch_drop(at[:, 0] - 0.5 * (left + right), right - left, rise)
        picture = np.where(inside, 40, 200).astype(np.uint8).reshape(view.height, view.width)
        return np.repeat(picture[..., None], 3, 2)

    return photo


def found(mesh, up=UP, photo=None, options=MeshOpeningOptions()):
    pixel = np.ones(len(mesh.vertices))
    flat = flatten_planes(mesh, pixel)
    plain = np.full((200, 240, 3), 200, np.uint8)
    photos = edge_photos(flat.mesh, cameras(), photo or (lambda number: plain))
    return find_wall_openings(flat.mesh, pixel, flat.planes, up, photos, options)


def test_openings_are_found_where_the_mesh_is_half_as_deep():
    (wall,) = found(sloped((BOX, OTHER)))
    boxes = wall.boxes[np.argsort(wall.boxes[:, 0])]
    np.testing.assert_allclose(boxes - [BOX, OTHER], 0, atol=0.6)
    np.testing.assert_allclose(wall.frame.axes, np.eye(3), atol=0.02)


def test_edges_come_from_the_photos_but_lower_ones():
    off = np.array([-1.5, -1.5, -1.5, 0.0])
    (wall,) = found(sloped((BOX + off,)), photo=painted(BOX))
    np.testing.assert_allclose(wall.boxes[0], BOX, atol=0.6)


@pytest.mark.parametrize(
    ("change", "up"),
    [
        ({}, np.array([0.0, 0.0, 1.0])),
        ({"area": 1e6}, UP),
        ({"detection": OpeningDetectionOptions(shape=0.05)}, UP),
    ],
    ids=["a roof", "small walls", "too deep"],
)
def test_none_are_found_in(change, up):
    assert found(sloped(), up, options=replace(MeshOpeningOptions(), **change)) == []


def test_one_opening_is_not_found_in_two_walls():
    mesh = sloped((BOX, OTHER))
    shifted = replace(mesh, vertices=mesh.vertices - np.array([0.0, 0.0, 8.0]))
    count = len(mesh.vertices)
    both = Mesh(
        np.concatenate([mesh.vertices, shifted.vertices]),
        np.concatenate([mesh.faces, shifted.faces + np.int32(count)]),
        np.zeros((2 * count, 3), np.uint8),
    )
    assert sorted(len(wall.boxes) for wall in found(both)) == [2]


def mirroring(mesh, rng):
    """The same mesh with panes that mirror: farther behind the wall in places, before it in others, with holes."""
    at, left, top, right, bottom = mesh.vertices.copy(), *BOX
    u, v = (at[:, 0] - left) / (right - left), (at[:, 1] - bottom) / (top - bottom)
    pane = (u > 0.15) & (u < 0.85) & (v > 0.1) & (v < 0.9)
    at[pane & (v < 0.4), 2] -= 6.0
    at[pane & (u > 0.6) & (v > 0.6), 2] += 2.5
    hole = (np.abs(u - 0.4) < 0.1) & (np.abs(v - 0.3) < 0.1)
    kept = ~hole[mesh.faces].any(1) & ~(pane[mesh.faces].all(1) & (rng.random(len(mesh.faces)) < 0.02))
    return Mesh(at, mesh.faces[kept], mesh.colors)


def test_an_opening_whose_pane_mirrors_is_found_and_cut():
    mesh = mirroring(sloped(), np.random.default_rng(0))
    walls = found(mesh)
    np.testing.assert_allclose(walls[0].boxes[0], BOX, atol=2.0)
    assert walls[0].depths[0] == pytest.approx(3.0, abs=0.8)
    result, count = cut_openings(mesh, walls)
    left, top, right, bottom = walls[0].boxes[0]
    centre = result.vertices[result.faces].mean(1)
    within = (np.abs(centre[:, 0] - (left + right) / 2) < 0.45 * (right - left)) & (
        np.abs(centre[:, 1] - (top + bottom) / 2) < 0.45 * (top - bottom)
    )
    assert count == 1
    np.testing.assert_allclose(centre[within, 2], -walls[0].depths[0], atol=0.05)


@pytest.mark.parametrize(("rise", "share"), [(15.2, 0.5), (6.0, 0.2)], ids=["semicircle", "segmental"])
def test_an_arched_opening_is_found_by_photos_and_cut(rise, share):
    (wall,) = found(arched(rise), photo=painted(BOX, rise))
    assert wall.rises[0] / (wall.boxes[0, 2] - wall.boxes[0, 0]) == pytest.approx(share, abs=0.06)
    np.testing.assert_allclose(wall.boxes[0], BOX, atol=1.0)
    assert cut_openings(arched(rise), [wall])[1] == 1


def test_where_photos_show_a_rectangle_the_contour_of_the_mesh_makes_no_arch():
    (wall,) = found(arched(6.0), photo=painted(BOX))
    assert wall.rises.tolist() == [0.0]
