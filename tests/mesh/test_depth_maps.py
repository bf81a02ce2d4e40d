# SPDX-License-Identifier: GPL-3.0-or-later
"""The order in which views are drawn and matched."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.mesh.depth_maps import visiting_order


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
