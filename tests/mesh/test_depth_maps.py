# SPDX-License-Identifier: GPL-3.0-or-later
"""The order in which views are drawn and matched, and the weights of their pixels."""

from __future__ import annotations

import numpy as np
import pytest
from support.analytic import camera, discs

from mgf_engine.mesh.depth_maps import FAR, depth_map, render_surface, visiting_order
from mgf_engine.mesh.fusion_options import TsdfOptions
from mgf_engine.mesh.photometric import RenderedSurface, without_match
from mgf_engine.raster.points import INSIDE


def most_waiting(near: list[list[int]], order: list[int]) -> int:
    """How many surfaces are held at most, when each goes after the last view that needs it."""
    wanted = [{number, *near[number]} for number in order]
    last = {k: place for place, numbers in enumerate(wanted) for k in numbers}
    held: set[int] = set()
    most = 0
    for place, numbers in enumerate(wanted):
        held |= numbers
        most = max(most, len(held))
        held -= {k for k in held if last[k] == place}
    return most


def shuffled_ring(count: int) -> list[list[int]]:
    """Views in a ring, each matched with the two at either side, in any order of their names."""
    place = np.random.default_rng(0).permutation(count)
    near: list[list[int]] = [[] for _ in range(count)]
    for k in range(count):
        near[place[k]] = [int(place[(k + step) % count]) for step in (-2, -1, 1, 2)]
    return near


def test_few_views_wait_for_each_other_whatever_their_names() -> None:
    near = shuffled_ring(200)
    order = visiting_order(near)
    assert sorted(order) == list(range(200))
    assert most_waiting(near, order) <= 12
    assert most_waiting(near, list(range(200))) > 100


@pytest.mark.parametrize("near", [[], [[]], [[], [], []], [[1], [0], [0, 1]]])
def test_any_views_have_an_order(near: list[list[int]]) -> None:
    assert sorted(visiting_order(near)) == list(range(len(near)))


def test_the_weight_of_a_pixel_is_the_squared_cosine_over_the_squared_depth() -> None:
    """A wall that faces the camera, 4 away; at the corner of the frame its rays are 29 degrees off."""
    view = camera((0.0, -4.0, 0.0))
    shape = view.height, view.width
    normal = np.zeros((*shape, 3), np.float32)
    normal[..., 2] = -1
    wall = RenderedSurface(
        view, np.zeros(shape, np.uint8), np.full(shape, 4.0, np.float32), normal, np.zeros(shape, bool)
    )
    found = depth_map(wall, np.full(shape, INSIDE, np.uint8), without_match(wall))
    depth, slope, weight, correlation = found.pixels.reshape(*shape, 4)[5:-5, 5:-5].transpose(2, 0, 1)
    x, y = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    u, v = (x - view.cx) / view.fx, (y - view.cy) / view.fy
    cosine = (1 / np.sqrt(1 + u**2 + v**2))[5:-5, 5:-5]
    assert (depth == 4).all() and (slope == 1).all() and (correlation == 0).all()
    np.testing.assert_allclose(weight, TsdfOptions.unmatched * cosine**2 / 16, rtol=1e-5)


def test_a_view_sees_a_surface_or_nothing_for_sure_or_looks_past_the_field() -> None:
    """An opaque disc, a faint one and nothing, side by side: opacities of 0.95, 0.35 and 0."""
    view = camera((0.0, -4.0, 0.0))
    places = np.array([[-0.8, 0, 0], [0.0, 0, 0], [0.8, 0, 0]])
    field = discs(places[:2], np.tile([[0.0, -1.0, 0.0]], (2, 1)), 0.1)
    field.opacity_logits[1] = float(np.log(0.35 / 0.65))
    found = render_surface(field, view)
    column, row = np.floor(view.project(places)[0]).astype(int).T
    assert found.depth[row, column] == pytest.approx([4.0, 0.0, 0.0], abs=0.01)
    assert found.free_space[row, column].tolist() == [False, False, True]


def test_where_a_view_looks_past_the_field_all_is_free() -> None:
    """Half of the frame shows a wall 4 away."""
    view = camera((0.0, -4.0, 0.0))
    shape = view.height, view.width
    normal = np.zeros((*shape, 3), np.float32)
    normal[..., 2] = -1
    through = np.indices(shape)[1] >= view.width // 2
    depth = np.where(through, 0, 4).astype(np.float32)
    half = RenderedSurface(view, np.zeros(shape, np.uint8), depth, normal, through)
    found = depth_map(half, np.full(shape, INSIDE, np.uint8), without_match(half))
    depth, _, weight, _ = found.pixels.reshape(*shape, 4).transpose(2, 0, 1)
    assert (depth[through] == FAR).all() and (depth[~through] == 4).all()
    assert weight[through] == pytest.approx(TsdfOptions.free_space_weight * np.median(weight[~through]))
