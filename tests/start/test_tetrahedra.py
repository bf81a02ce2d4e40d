# SPDX-License-Identifier: GPL-3.0-or-later
"""Two tetrahedra on one face: their volumes, neighbours, and those around each point."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from mgf_engine.start import tetrahedra
from mgf_engine.start.tetrahedra import FACE_CORNERS, Tetrahedra, orient_positive

#: A corner of the unit cube, and a point twice as far on the other side of the face that is opposite of the origin.
POINTS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
CORNERS = np.array([[0, 1, 2, 3], [1, 2, 3, 4]], np.int32)


def volume(corners: np.ndarray) -> float:
    a, b, c, d = POINTS[corners]
    return float(np.linalg.det([b - a, c - a, d - a]) / 6)


@pytest.mark.parametrize("turned", [False, True])
def test_volumes_are_positive_after_turning(turned: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tetrahedra, "_CHUNK", 1)
    given = CORNERS[:, [1, 0, 2, 3]] if turned else CORNERS
    given = np.where([[True], [volume(given[1]) * volume(given[0]) > 0]], given, given[:, [1, 0, 2, 3]])
    found = orient_positive(POINTS, np.ascontiguousarray(given, np.int32))
    assert [volume(corners) for corners in found] == pytest.approx([1 / 6, 1 / 3])
    cells = Tetrahedra(POINTS, found)
    assert [float(cells.volumes(chunk)[0]) for chunk in cells.chunks()] == pytest.approx([1 / 6, 1 / 3])


def test_a_flat_one_tells_nothing_of_the_sense(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tetrahedra, "_CHUNK", 1)
    flat = np.concatenate([POINTS, [[0.5, 0.5, -1e-9]]])  # beside the plane of 0, 1 and 2, on the wrong side
    corners = np.array([[0, 1, 2, 3], [0, 1, 2, 5]], np.int32)
    np.testing.assert_array_equal(orient_positive(flat, corners), corners)


def test_faces_look_outward() -> None:
    positive = orient_positive(POINTS, CORNERS[:1])[0]
    middle = POINTS[positive].mean(0)
    for corners in FACE_CORNERS:
        a, b, c = POINTS[positive[corners]]
        assert np.cross(b - a, c - a) @ (a - middle) > 0


def test_neighbours_lie_beyond_the_face_opposite_of_a_corner() -> None:
    cells = Tetrahedra(POINTS, CORNERS)
    np.testing.assert_array_equal(cells.neighbours, [[1, -1, -1, -1], [-1, -1, -1, 0]])
    first, listed = cells.around()
    around = [sorted(listed[a:b].tolist()) for a, b in pairwise(first)]
    assert around == [[0], [0, 1], [0, 1], [0, 1], [1]]
