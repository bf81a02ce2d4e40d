# SPDX-License-Identifier: GPL-3.0-or-later
"""A wall with a dent that photos confirm or do not."""

from dataclasses import replace

import numpy as np
import pytest

from mgf_engine.mesh.low_confidence_fill import fill_low_confidence
from mgf_engine.model.mesh import Mesh

SIDE = 40


def wall(half: float, depth: float = 0.3) -> tuple[Mesh, np.ndarray]:
    """SIDE x SIDE vertices on z = 0 with a dent of this half width (of 1) in the middle; which vertices are in it."""
    x, y = (grid.ravel() for grid in np.meshgrid(np.linspace(-1, 1, SIDE), np.linspace(-1, 1, SIDE)))
    dent = np.maximum(np.abs(x), np.abs(y)) < half
    corner = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    a, b, c, d = (part.ravel() for part in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]))
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])]).astype(np.int32)
    vertices = np.column_stack([x, y, np.where(dent, -depth, 0.0)])
    return Mesh(vertices, faces, np.zeros((len(x), 3), np.uint8)), dent


def test_a_dent_that_nothing_confirms_becomes_flat() -> None:
    mesh, dent = wall(0.1)
    flat = fill_low_confidence(mesh, np.where(dent, 0.1, 0.9))
    assert np.abs(flat.vertices[:, 2]).max() < 1e-9
    assert np.array_equal(flat.vertices[~dent], mesh.vertices[~dent])
    assert np.array_equal(flat.faces, mesh.faces)
    inside = flat.vertices[dent]
    assert np.abs(inside).max() < 0.15 and len(np.unique(inside.round(6), axis=0)) == dent.sum()  # nothing folds up


def test_a_dent_that_photos_confirm_stays() -> None:
    mesh, dent = wall(0.1)
    assert np.array_equal(fill_low_confidence(mesh, np.where(dent, 0.5, 0.9)).vertices, mesh.vertices)


def test_what_stands_out_stays_unless_it_is_a_bag() -> None:
    """A corner that few photos see is not cut off, a spike is."""
    low, high = wall(0.1, depth=-0.04), wall(0.1, depth=-0.6)
    confidence = np.where(low[1], 0.1, 0.9)
    assert np.array_equal(fill_low_confidence(low[0], confidence).vertices, low[0].vertices)
    assert np.abs(fill_low_confidence(high[0], confidence).vertices[:, 2]).max() < 1e-9


def test_a_large_patch_is_not_tested() -> None:
    mesh, dent = wall(0.5)
    assert np.array_equal(fill_low_confidence(mesh, np.where(dent, 0.0, 0.9)).vertices, mesh.vertices)


def test_open_edges_and_parts_of_their_own_stay() -> None:
    mesh, _ = wall(0.1)
    corner = np.maximum(mesh.vertices[:, 0], mesh.vertices[:, 1]) < -0.9
    rim = corner & (np.abs(mesh.vertices[:, :2]).max(1) > 1 - 1e-9)
    bent = mesh.vertices + np.where(rim, 0.2, 0.0)[:, None] * [0, 0, 1]
    shifted = Mesh(bent, mesh.faces, mesh.colors)
    stretched = fill_low_confidence(shifted, np.where(corner, 0.0, 0.9))
    assert rim.any() and np.array_equal(stretched.vertices[rim], bent[rim])
    ball = np.array([[0.0, 0, 1], [0.1, 0, 1], [0, 0.1, 1], [0, 0, 1.1]])
    closed = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], np.int32) + len(mesh.vertices)
    both = Mesh(
        np.concatenate([mesh.vertices, ball]), np.concatenate([mesh.faces, closed]),
        np.zeros((len(mesh.vertices) + 4, 3), np.uint8),
    )  # fmt: skip
    confidence = np.r_[np.full(len(mesh.vertices), 0.9), np.zeros(4)]
    assert np.array_equal(fill_low_confidence(both, confidence).vertices, both.vertices)


def hung_on(mesh: Mesh, *corners: int) -> Mesh:
    """A closed tetrahedron more, of these vertices of the mesh and new ones."""
    new = 4 - len(corners)
    names = [*corners, *range(len(mesh.vertices), len(mesh.vertices) + new)]
    spots = mesh.vertices[corners[0]] + 0.05 * np.array([[0, 0, -1.0], [1, 0, -1], [0, 1, -1]])[:new]
    closed = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    faces = np.concatenate([mesh.faces, np.array(names)[closed]]).astype(np.int32)
    colors = np.zeros((len(mesh.vertices) + new, 3), np.uint8)
    return Mesh(np.concatenate([mesh.vertices, spots]), faces, colors)


def test_a_bag_that_hangs_on_a_dent_goes() -> None:
    mesh, dent = wall(0.1)
    bag = hung_on(mesh, int(np.flatnonzero(dent)[5]))
    confidence = np.r_[np.where(dent, 0.1, 0.9), np.zeros(3)]
    flat = fill_low_confidence(replace(bag, values={"confidence": confidence}), confidence)
    assert len(flat.vertices) == len(mesh.vertices) == len(flat.values["confidence"])
    assert np.array_equal(flat.faces, mesh.faces) and np.abs(flat.vertices[:, 2]).max() < 1e-9


def test_no_edge_gets_three_faces() -> None:
    mesh, dent = wall(0.1)
    first, second = mesh.faces[np.flatnonzero((~dent)[mesh.faces].all(1))[700], :2].tolist()
    crowded = hung_on(mesh, first, second)
    confidence = np.r_[np.where(dent, 0.1, 0.9), np.zeros(2)]
    assert np.array_equal(fill_low_confidence(crowded, confidence).vertices, crowded.vertices)


@pytest.mark.parametrize("confidence", [0.0, 1.0])
def test_all_or_nothing_confirmed_changes_nothing(confidence: float) -> None:
    mesh, _ = wall(0.1)
    result = fill_low_confidence(mesh, np.full(len(mesh.vertices), confidence))
    assert np.array_equal(result.vertices, mesh.vertices)
