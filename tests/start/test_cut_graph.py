# SPDX-License-Identifier: GPL-3.0-or-later
"""The minimum cut between tetrahedra against scipy's maximum flow: value and sides are the same."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mgf_engine.geometry.delaunay import delaunay
from mgf_engine.native import library
from mgf_engine.start import reference
from mgf_engine.start.cut_graph import Flow
from mgf_engine.start.tetrahedra import Tetrahedra


@pytest.fixture(params=library.runnable_variants(), autouse=True)
def variant(request: pytest.FixtureRequest):
    library.use_variant(request.param)
    yield
    library.use_variant("")


def row_of(count: int) -> NDArray[np.int32]:
    """Neighbours of cells in a row, each before the next."""
    neighbours = np.full((count, 4), -1, np.int32)
    neighbours[1:, 2], neighbours[:-1, 0] = np.arange(count - 1), np.arange(1, count)
    return neighbours


def whole(values: NDArray[np.float64]) -> NDArray[np.int32]:
    return np.rint(values).astype(np.int32)


def test_a_row_is_cut_at_its_narrowest_face() -> None:
    flow = Flow(row_of(5))
    flow.residual[:-1, 0] = [3, 2, 1, 2]
    flow.add(np.array([9.0, 0, 0, 0, 0]), np.array([0, 0, 0, 0, 9.0]))
    assert flow.cut().tolist() == [False, False, False, True, True]
    assert flow.value == 1
    assert flow.residual[:-1, 0].tolist() == [2, 1, 0, 1]
    assert flow.residual[1:, 2].tolist() == [1, 1, 1, 1]  # what flowed may flow back
    assert flow.excess.tolist() == [8, 0, 0, 0, -8]


def test_what_nothing_pulls_inside_is_outside() -> None:
    flow = Flow(row_of(3))
    flow.add(np.array([2.0, 0, 1.0]), np.array([0, 0, 1.0]))
    assert not flow.cut().any()
    assert flow.value == 1  # a cell's own


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("most", [3, 1000])
def test_value_and_sides_are_those_of_the_reference(seed: int, most: int) -> None:
    """Few different capacities make many ties, which are decided the same way, too."""
    rng = np.random.default_rng(seed)
    points = rng.random((300, 3))
    neighbours = Tetrahedra(points, delaunay(points)).neighbours
    flow, count = Flow(neighbours), len(neighbours)
    capacity = rng.integers(0, most, neighbours.shape) * (rng.random(neighbours.shape) < 0.8)
    flow.residual[:] = np.where(neighbours < 0, 0, capacity)
    left = np.zeros(count, np.int32)
    for _ in range(3):  # each adds to what the one before left over
        source, sink = (rng.integers(0, 4 * most, count) * (rng.random(count) < 0.2) for _ in range(2))
        before, capacity = flow.value, whole(flow.residual)
        own = np.minimum(np.maximum(left, 0) + source, np.maximum(-left, 0) + sink).sum()
        flow.add(source.astype(float), sink.astype(float))
        value, inside = reference.cut_cells(neighbours, capacity, whole(flow.excess))
        np.testing.assert_array_equal(flow.cut(), inside)
        assert flow.value - before == value + own
        assert 0 < inside.sum() < count
        left = whole(flow.excess)
    assert (flow.residual >= 0).all()


def test_flow_is_kept_where_it_passes() -> None:
    """What flows into a cell flows on: residuals differ from the capacities by as much as the excesses do."""
    rng = np.random.default_rng(7)
    points = rng.random((200, 3))
    neighbours = Tetrahedra(points, delaunay(points)).neighbours
    flow = Flow(neighbours)
    flow.residual[:] = np.where(neighbours < 0, 0, rng.random(neighbours.shape))
    before = flow.residual.copy()
    flow.add(rng.random(len(neighbours)), rng.random(len(neighbours)))
    excess = flow.excess.copy()
    flow.cut()
    np.testing.assert_allclose((before - flow.residual).sum(1), excess - flow.excess, atol=1e-12)
