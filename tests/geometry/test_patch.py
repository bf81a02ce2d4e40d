# SPDX-License-Identifier: GPL-3.0-or-later
"""A patch of a mesh is taken out, split along a rectangle and put back; shape and neighbours stay."""

import numpy as np
import pytest

from mgf_engine.geometry.clean import open_edges
from mgf_engine.geometry.patch import (
    Patch,
    change_part,
    faces_over_rectangle,
    faces_touching,
    split_along_rectangle,
)
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.topology import half_edges
from tests.support.sheets import joined, sheet

SIDE = np.arange(0, 11.0)
BOX = np.array([2.3, 7.6, 6.9, 3.25])  # left, top, right, bottom


def plane() -> Patch:
    """A level sheet of 10 x 10 in z = 1."""
    mesh = joined(sheet(SIDE, SIDE, lambda u, v: (u, v, np.ones_like(u))))
    return Patch(mesh.vertices, mesh.faces.astype(np.int64), np.arange(len(mesh.vertices)))


def areas(patch: Patch) -> np.ndarray:
    a, b, c = (patch.vertices[patch.faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)[:, 2] / 2


def as_mesh(patch: Patch) -> Mesh:
    return Mesh(patch.vertices, patch.faces.astype(np.int32), np.zeros(patch.vertices.shape, np.uint8))


def is_within(patch: Patch) -> np.ndarray:
    left, top, right, bottom = BOX
    x, y = patch.vertices[patch.faces, 0], patch.vertices[patch.faces, 1]
    return (x >= left).all(1) & (x <= right).all(1) & (y >= bottom).all(1) & (y <= top).all(1)


def test_faces_are_split_along_the_sides_and_stay_neighbours() -> None:
    before = plane()
    after = split_along_rectangle(before, BOX, 0.05)
    assert areas(after).min() > 0 and areas(after).sum() == pytest.approx(100), "none turned, none lost"
    assert areas(after)[is_within(after)].sum() == pytest.approx((6.9 - 2.3) * (7.6 - 3.25))
    assert len(open_edges(as_mesh(after))[0]) == len(open_edges(as_mesh(before))[0]), "no gap along the sides"
    np.testing.assert_array_equal(after.vertices[: len(before.vertices)], before.vertices)


def test_new_vertices_have_the_source_of_the_nearer_end() -> None:
    before = plane()
    after = split_along_rectangle(before, np.array([2.3, 20.0, 20.0, -20.0]), 0.05)  # only its left side meets the mesh
    new = slice(len(before.vertices), None)
    ends = before.vertices[after.source[new]]
    assert len(ends) and (ends[:, 0] == 2).all()
    assert (np.abs(ends[:, 1] - after.vertices[new, 1]) < 0.5).all()


def test_vertices_near_a_side_move_onto_it_and_leave_no_sliver() -> None:
    before = plane()
    after = split_along_rectangle(before, np.array([2.04, 8.0, 7.0, 3.0]), 0.05)
    kept = after.vertices[: len(before.vertices)]
    moved = np.flatnonzero((kept != before.vertices).any(1))
    assert (before.vertices[moved, 0] == 2).all() and (kept[moved, 0] == 2.04).all()
    assert before.vertices[moved, 1].tolist() == [3, 4, 5, 6, 7, 8], "along the side only"
    new = after.vertices[len(before.vertices) :]
    assert not ((new[:, 1] > 3) & (new[:, 1] < 8)).any(), "within it nothing had to be divided"


def test_a_changed_part_is_put_back_with_its_new_vertices_at_the_end() -> None:
    whole = plane()
    some = is_within(whole)

    def raise_and_add(part: Patch) -> Patch:
        corner = len(part.vertices) + np.arange(3)
        return Patch(
            np.concatenate([part.vertices + np.array([0, 0, 1.0]), part.vertices[:3]]),
            np.concatenate([part.faces, corner[None]]),
            np.concatenate([part.source, part.source[:3]]),
        )

    after = change_part(whole, some, raise_and_add)
    assert after is not None and len(after.faces) == len(whole.faces) + 1
    raised = after.vertices[: len(whole.vertices), 2] == 2
    np.testing.assert_array_equal(np.flatnonzero(raised), np.unique(whole.faces[some]))
    np.testing.assert_array_equal(after.faces[-1], len(whole.vertices) + np.arange(3))
    np.testing.assert_array_equal(after.vertices[after.faces[-1]], whole.vertices[after.source[after.faces[-1]]])
    assert change_part(whole, some, lambda part: None) is None


def test_faces_over_a_rectangle_and_those_that_touch_them() -> None:
    patch = plane()
    over = faces_over_rectangle(patch.vertices, patch.faces, np.array([4.2, 5.2]), np.array([4.8, 5.8]))
    assert over.sum() == 2, "both halves of one square"
    assert not faces_over_rectangle(patch.vertices, patch.faces, np.array([10.0, 2.0]), np.array([12.0, 3.0])).any()
    touching = faces_touching(patch.faces, over)
    assert (touching & over).sum() == 2 and np.isin(patch.faces[touching], patch.faces[over]).any(1).all()
    assert not np.isin(patch.faces[~touching], patch.faces[over]).any()


def test_edges_have_the_direction_of_their_faces() -> None:
    found = half_edges(np.array([[0, 1, 2], [2, 1, 3]]))
    assert found.tolist() == [[0, 1], [1, 2], [2, 0], [2, 1], [1, 3], [3, 2]]
