# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixels of a drawing: where they lie, what they hold, and what a mesh looks like on them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mgf_engine.drawings.model import DrawingFrame
from mgf_engine.drawings.project import MARGIN, plan_grid, render_grid, round_resolution
from mgf_engine.errors import BadInput
from mgf_engine.geometry.rasterize import face_normals
from mgf_engine.model.mesh import Mesh

X, Y, Z = np.eye(3)


def plan(width: float = 2.0, height: float = 1.0) -> DrawingFrame:
    return DrawingFrame("plan", np.zeros(3), X, Y, np.zeros(2), np.array([width, height]))


def test_a_grid_covers_its_frame_and_a_margin() -> None:
    grid = plan_grid(plan(), 0.1)
    assert (grid.width, grid.height) == (20 + 2 * MARGIN, 10 + 2 * MARGIN)
    np.testing.assert_allclose(grid.pixels(np.array([[0.0, 1.0]])), [[MARGIN, MARGIN]], atol=1e-9)
    np.testing.assert_allclose(grid.places(grid.pixels(np.array([[1.37, 0.21]]))), [[1.37, 0.21]], atol=1e-12)


def test_a_drawing_too_large_for_memory_names_a_resolution_that_fits() -> None:
    with pytest.raises(BadInput, match=r"give --resolution (\d+)") as refused:
        plan_grid(plan(1000.0, 1000.0), 0.01)
    fits = float(str(refused.value).split("--resolution ")[1].split()[0]) / 1000
    plan_grid(plan(1000.0, 1000.0), fits)


@pytest.mark.parametrize("value,rounded", [(0.0123, 0.01), (0.0999, 0.08), (1.0, 1.0), (2.9, 2.0), (0.00158, 0.0015)])
def test_resolutions_are_rounded_to_finer_ones(value: float, rounded: float) -> None:
    assert round_resolution(value) == pytest.approx(rounded)


def test_values_are_looked_up_where_places_lie_and_beside_the_grid_are_those_asked_for() -> None:
    grid = plan_grid(plan(), 0.1)
    values = np.arange(grid.height * grid.width, dtype=np.int32).reshape(grid.height, grid.width)
    at = grid.places(np.array([[0.5, 0.5], [3.2, 1.9], [grid.width - 0.01, grid.height - 0.01]]))
    last = grid.width * grid.height - 1
    np.testing.assert_array_equal(grid.look_up(values, at, -7), [0, grid.width + 3, last])
    beside = grid.places(np.array([[-0.1, 2.0], [2.0, -0.1], [grid.width + 0.1, 2.0], [2.0, grid.height + 0.1]]))
    np.testing.assert_array_equal(grid.look_up(values, beside, -7), [-7] * 4)
    three = np.column_stack([at, np.full(len(at), 99.0)])
    np.testing.assert_array_equal(grid.look_up(values, three, -7), grid.look_up(values, at, -7))


def test_the_nearest_face_is_seen_and_backs_are_not() -> None:
    square = np.array([[0.0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]])
    low, high = square + 0.1 * Z, square * (0.5, 1, 1) + 0.4 * Z
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    vertices = np.concatenate([low, high])
    for turned in (False, True):
        upper = faces[:, ::-1] if turned else faces
        mesh = Mesh(vertices, np.concatenate([faces, upper + 4]).astype(np.int32), np.zeros((8, 3), np.uint8))
        survey = SimpleNamespace(mesh=mesh, normals=face_normals(mesh))
        seen = render_grid(survey, plan_grid(plan(), 0.1))  # type: ignore[arg-type]
        row, left, right = MARGIN + 5, MARGIN + 5, MARGIN + 15
        assert seen.before[row, right] == pytest.approx(0.1) and seen.face[row, right] in (0, 1)
        assert seen.face[0, 0] == -1 and np.isnan(seen.before[0, 0])
        if turned:
            assert seen.face[row, left] == -1 and np.isnan(seen.before[row, left])
        else:
            assert seen.before[row, left] == pytest.approx(0.4) and seen.face[row, left] in (2, 3)
            point = seen.points(np.array([row * seen.grid.width + left]))
            np.testing.assert_allclose(point, [[0.55, 0.45, 0.4]], atol=1e-6)
