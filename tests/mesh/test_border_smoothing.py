# SPDX-License-Identifier: GPL-3.0-or-later
"""Borders of the mesh: straight where faces are removed, without what no photo confirms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mgf_engine.geometry.clean import face_areas, open_edges, with_faces
from mgf_engine.geometry.normals import face_cross_products
from mgf_engine.mesh.border_smoothing import (
    MeshBorderOptions,
    find_supported_faces,
    remove_faces,
    smooth_border,
    trim_border,
)
from mgf_engine.model.mesh import Mesh

SIDE = 60


def sheet() -> Mesh:
    """A flat square of 60 x 60 cells of one pixel, with vertices shaken within it."""
    x, y = np.meshgrid(np.arange(SIDE + 1.0), np.arange(SIDE + 1.0), indexing="ij")
    at = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], 1)
    inner = ((at[:, :2] > 0) & (at[:, :2] < SIDE)).all(1)
    at[inner, :2] += np.random.default_rng(0).uniform(-0.3, 0.3, (inner.sum(), 2))
    first = (np.arange(SIDE)[:, None] * (SIDE + 1) + np.arange(SIDE)).ravel()
    right, above = first + SIDE + 1, first + 1
    faces = np.concatenate([np.stack([first, right, right + 1], 1), np.stack([first, right + 1, above], 1)])
    return Mesh(at, faces.astype(np.int32), np.zeros((len(at), 3), np.uint8))


def centres(mesh: Mesh) -> np.ndarray:
    return np.asarray(mesh.vertices[mesh.faces].mean(1))


def new_border(mesh: Mesh) -> np.ndarray:
    """Places [K, 2] of the border's vertices that are not on the outline of the square."""
    at = mesh.vertices[np.unique(np.concatenate(open_edges(mesh))), :2]
    return np.asarray(at[((at > 1e-9) & (at < SIDE - 1e-9)).all(1)])


def test_teeth_become_a_straight_line() -> None:
    """Faces are cut along x = 30, with teeth five pixels high and two wide."""
    mesh = sheet()
    teeth = 2.5 * (-1.0) ** np.arange(100)
    kept = centres(mesh)[:, 0] < 30 + teeth[(centres(mesh)[:, 1] / 2).astype(int)]
    ragged = new_border(remove_faces(mesh, kept, np.ones(len(mesh.vertices)), MeshBorderOptions(spread=0)))
    smooth = new_border(remove_faces(mesh, kept, np.ones(len(mesh.vertices))))
    assert np.std(ragged[:, 0]) > 1.2
    assert np.std(smooth[:, 0]) < 0.6 and abs(smooth[:, 0].mean() - 30) < 0.5
    assert (face_areas(remove_faces(mesh, kept, np.ones(len(mesh.vertices)))) > 0).all()


def test_a_line_stays_where_it_is_and_a_thin_strip_goes() -> None:
    mesh = sheet()
    x, y = centres(mesh)[:, :2].T
    strip = (np.abs(y - 30) < 1.5) & (x >= 30)  # three pixels wide, from the line to the outline
    cut = remove_faces(mesh, (x < 30) | strip, np.ones(len(mesh.vertices)))
    assert cut.vertices[:, 0].max() < 33
    assert abs(np.median(new_border(cut)[:, 0]) - 30) < 0.3


def test_an_unconfirmed_fringe_goes_and_an_unconfirmed_hole_stays_closed() -> None:
    mesh = sheet()
    x, y = mesh.vertices[:, :2].T
    hole = np.hypot(x - 20, y - 30) < 6
    views = np.where((x > 45) | hole, 0, 2)
    kept = find_supported_faces(mesh, views, np.full(len(x), 60.0))
    at = centres(mesh)
    assert kept[at[:, 0] < 44].all() and not kept[at[:, 0] > 46].any()


def test_a_small_open_hole_is_no_border() -> None:
    """Nothing confirms what is around a small hole, which will be closed: the wall stays."""
    mesh = sheet()
    away = np.hypot(*(centres(mesh)[:, :2] - 30).T)
    pierced = Mesh(mesh.vertices, mesh.faces[away > 3], mesh.colors)
    views = np.where(np.hypot(*(mesh.vertices[:, :2] - 30).T) < 8, 0, 2)
    kept = find_supported_faces(pierced, views, np.full(len(mesh.vertices), 60.0))
    assert kept.all()
    assert not find_supported_faces(pierced, views, np.full(len(mesh.vertices), 6.0)).all()


def test_nothing_changes_where_all_stays() -> None:
    mesh = sheet()
    same = remove_faces(mesh, np.ones(len(mesh.faces), bool), np.ones(len(mesh.vertices)))
    assert np.array_equal(same.faces, mesh.faces) and np.array_equal(same.vertices, mesh.vertices)


def test_what_the_fringe_held_falls_with_it_and_a_part_of_its_own_stays() -> None:
    """A confirmed scrap beyond the fringe goes; a confirmed chimney of that size, apart from the start, stays."""
    mesh = sheet()
    x, y = mesh.vertices[:, :2].T
    scrap = np.hypot(x - 55, y - 30) < 3
    chimney = Mesh(mesh.vertices / 10 + [0, 0, 50], mesh.faces, mesh.colors)
    both = Mesh(
        np.concatenate([mesh.vertices, chimney.vertices]),
        np.concatenate([mesh.faces, chimney.faces + len(x)]).astype(np.int32),
        np.concatenate([mesh.colors, chimney.colors]),
    )
    views = np.r_[np.where((x > 45) & ~scrap, 0, 2), np.ones(len(x), int)]
    ones = np.ones(len(both.vertices))
    trimmed = trim_border(both, views, ones, 60 * ones, MeshBorderOptions(fallen=0.05))
    low = trimmed.vertices[trimmed.vertices[:, 2] < 1]
    assert low[:, 0].max() < 47 and (trimmed.vertices[:, 2] > 1).sum() == len(x)
    assert not trimmed.values


def test_a_mesh_of_which_nothing_is_confirmed_stays() -> None:
    mesh = sheet()
    ones = np.ones(len(mesh.vertices))
    assert trim_border(mesh, np.zeros(len(ones), int), ones, 60 * ones) is mesh


def ragged(bend: float = 0.0) -> Mesh:
    """The square up to x = 30, with teeth two pixels high and one wide; bent by an angle along y = 30."""
    mesh = sheet()
    x, y, _ = centres(mesh).T
    mesh = with_faces(mesh, mesh.faces[x < 30 + (-1.0) ** y.astype(int)])
    x, y, _ = mesh.vertices.T
    over = np.maximum(y - 30, 0)
    at = np.stack([x, y - over + over * np.cos(bend), over * np.sin(bend)], 1)
    return replace(mesh, vertices=at)


def cut_line(mesh: Mesh) -> np.ndarray:
    """Vertices [K] of the border along the cut."""
    rows = np.unique(np.concatenate(open_edges(mesh)))
    at = mesh.vertices[rows]
    return np.asarray(rows[(at[:, 0] > 20) & (at[:, 1] > 1e-9) & (np.abs(at[:, 1] - SIDE) > 1e-9)])


def test_a_border_that_stays_loses_its_teeth() -> None:
    mesh = ragged()
    result = smooth_border(mesh, np.ones(len(mesh.vertices)))
    line = cut_line(mesh)
    line = line[np.argsort(mesh.vertices[line, 1])]
    before, after = mesh.vertices[line, 0], result.vertices[line, 0]
    assert np.abs(np.diff(before)).mean() > 0.5
    assert np.abs(np.diff(after)).mean() < 0.3 * np.abs(np.diff(before)).mean()
    assert abs(after.mean() - before.mean()) < 0.15, "it does not shrink"
    assert not result.vertices[:, 2].any(), "the wall stays flat"
    up_before, up = (face_cross_products(at, mesh.faces)[:, 2] for at in (mesh.vertices, result.vertices))
    assert (up[up_before > 0] > -1e-5).all(), "no face turns over"
    far = np.abs(mesh.vertices[:, 0] - 30) > 10
    inner = far & (mesh.vertices[:, :2] > 5).all(1) & (mesh.vertices[:, 1] < SIDE - 5)
    assert np.array_equal(result.vertices[inner], mesh.vertices[inner])


def test_corners_of_a_building_and_borders_without_rounds_stay() -> None:
    mesh = ragged(bend=np.pi / 2)
    result = smooth_border(mesh, np.ones(len(mesh.vertices)))
    corner = np.abs(mesh.vertices[:, 1] - 30) < 1e-9
    corner &= np.abs(mesh.vertices[:, 2]) < 1e-9
    assert corner.any()
    assert np.abs(result.vertices[corner] - mesh.vertices[corner])[:, 1:].max() < 1e-9
    assert smooth_border(mesh, np.ones(len(mesh.vertices)), MeshBorderOptions(smooth_rounds=0)) is mesh
    closed = with_faces(mesh, mesh.faces[:0])
    assert smooth_border(closed, np.ones(len(closed.vertices))) is closed
    whole = np.full(len(mesh.vertices), 1000.0)
    assert smooth_border(mesh, whole) is mesh, "its border is a hole"
