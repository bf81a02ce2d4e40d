# SPDX-License-Identifier: GPL-3.0-or-later
"""Borders of label maps that are small enough to draw by hand."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.drawings.trace import trace


def lengths(label: list[list[int]]) -> dict[tuple[int, int], float]:
    """Labels on both sides -> length of all borders between them, pixels."""
    found: dict[tuple[int, int], float] = {}
    for chain in trace(np.array(label, np.int32)):
        length = float(np.abs(np.diff(chain.corners, axis=0)).sum())
        found[chain.low, chain.high] = found.get((chain.low, chain.high), 0.0) + length
    return found


def test_one_label_has_no_border() -> None:
    assert trace(np.zeros((4, 5), np.int32)) == []


def test_a_pixel_has_a_closed_border() -> None:
    (chain,) = trace(np.array([[0, 0, 0], [0, 7, 0], [0, 0, 0]], np.int32))
    assert chain.closed and (chain.low, chain.high) == (0, 7)
    assert len(chain.corners) == 5 and (chain.corners[0] == chain.corners[-1]).all()
    assert {tuple(c) for c in chain.corners.tolist()} == {(1, 1), (2, 1), (2, 2), (1, 2)}


def test_borders_end_where_three_labels_meet() -> None:
    label = [[1, 1, 2, 2], [1, 1, 2, 2], [3, 3, 3, 3]]
    chains = trace(np.array(label, np.int32))
    assert lengths(label) == {(1, 2): 2.0, (1, 3): 2.0, (2, 3): 2.0}
    assert len(chains) == 3 and not any(chain.closed for chain in chains)
    meeting = set.intersection(*({tuple(c.corners[0]), tuple(c.corners[-1])} for c in chains))
    assert meeting == {(2.0, 2.0)}


@pytest.mark.parametrize("seed", range(5))
def test_every_side_between_two_labels_is_on_one_border(seed: int) -> None:
    label = np.random.default_rng(seed).integers(0, 3, (9, 11)).astype(np.int32)
    sides = int((label[:, 1:] != label[:, :-1]).sum() + (label[1:] != label[:-1]).sum())
    steps = [np.abs(np.diff(chain.corners, axis=0)) for chain in trace(label)]
    assert all((step.sum(1) == 1).all() for step in steps)
    assert sum(len(step) for step in steps) == sides
