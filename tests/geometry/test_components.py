# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

import numpy as np

from mgf_engine.geometry.components import label_components

NONE = np.zeros(0, np.int64)


def test_components_are_numbered_by_their_first_nodes() -> None:
    first, second = np.array([[5, 1], [1, 3], [4, 0]]).T
    assert label_components(6, first, second).tolist() == [0, 1, 2, 1, 0, 1]


def test_nodes_without_edges_are_components() -> None:
    assert label_components(3, NONE, NONE).tolist() == [0, 1, 2]
    assert label_components(0, NONE, NONE).tolist() == []


def test_edges_may_be_given_any_number_of_times() -> None:
    """Their weights are not added up: a sum of 256 would be 0 in 8 bits, no edge."""
    assert label_components(2, np.zeros(256, int), np.ones(256, int)).tolist() == [0, 0]
