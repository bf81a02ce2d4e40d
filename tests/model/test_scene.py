# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras project and unproject by the pinhole model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from mgf_engine.model.scene import View


def camera() -> View:
    """fx 100, fy 50, principal point (20, 10), at (1, 2, 3), looking along the world's x with its z up."""
    rotation = np.array([[0, -1.0, 0], [0, 0, -1.0], [1.0, 0, 0]])
    return View("a", "", 40, 20, 100, 50, 20, 10, rotation, -rotation @ [1.0, 2.0, 3.0], 40, 20)


def test_a_pixel_shows_the_point_at_its_depth() -> None:
    """10 px right of the principal point at depth 5: 0.5 to the right; 10 px below it: 1 down."""
    found = camera().unproject(np.array([[20.0, 10.0], [30.0, 20.0]]), np.array([4.0, 5.0]))
    assert np.allclose(found, [[5, 2, 3], [6, 1.5, 2]], atol=1e-12)


def test_unprojecting_undoes_projecting() -> None:
    random = np.random.default_rng(0)
    rotation = Rotation.random(rng=random).as_matrix()
    view = View("a", "", 40, 20, 100, 50, 20, 10, rotation, random.normal(size=3), 40, 20)
    uv, depth = random.uniform(0, 20, (50, 2)), random.uniform(1, 9, 50)
    again = view.project(view.unproject(uv, depth))
    assert np.allclose(again[0], uv, atol=1e-9) and np.allclose(again[1], depth, atol=1e-12)


def at_pixels(view: View, uv: list[list[float]], depth: float = 2.0) -> np.ndarray:
    return view.unproject(np.array(uv), np.full(len(uv), depth))


def test_points_in_the_frame_and_points_beyond_each_edge_of_it() -> None:
    """The frame is 40 x 20 px; its right and lower edge belong to no pixel of it."""
    view = camera()
    inside = at_pixels(view, [[0.01, 0.01], [39.99, 19.99], [20.0, 10.0]])
    outside = at_pixels(view, [[-0.01, 10], [40.01, 10], [20, -0.01], [20, 20.01]])
    uv, depth, found = view.project_into_frame(np.concatenate([inside, outside]))
    assert found.tolist() == [True] * 3 + [False] * 4
    assert np.allclose(uv[0], 0.01) and np.allclose(depth, 2.0)


def test_the_corner_of_the_first_pixel_is_in_the_frame() -> None:
    view = replace(camera(), cx=0.0, cy=0.0)
    uv, _, found = view.project_into_frame(view.centre[None] + [[1.0, 0, 0]])
    assert uv.tolist() == [[0, 0]] and found.all()


def test_points_behind_the_camera_and_at_it_are_not_in_the_frame() -> None:
    view = camera()
    behind = view.unproject(np.array([[20.0, 10.0]]), np.array([-2.0]))
    assert np.allclose(view.project(behind)[0], [20, 10])  # the same pixel
    assert not view.project_into_frame(np.concatenate([behind, view.centre[None]]))[2].any()


def test_points_that_are_not_numbers_are_not_in_the_frame() -> None:
    assert not camera().project_into_frame(np.full((2, 3), np.nan))[2].any()


def test_a_margin_is_kept_on_all_sides() -> None:
    view = camera()
    inside = at_pixels(view, [[3.01, 10], [36.99, 10], [20, 3.01], [20, 16.99]])
    outside = at_pixels(view, [[2.99, 10], [37.01, 10], [20, 2.99], [20, 17.01]])
    found = view.project_into_frame(np.concatenate([inside, outside]), margin=3)[2]
    assert found.tolist() == [True] * 4 + [False] * 4
