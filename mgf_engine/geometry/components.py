# SPDX-License-Identifier: GPL-3.0-or-later
"""Connected components of a graph that is given by its edges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


def label_components(count: int, first: NDArray[np.integer], second: NDArray[np.integer]) -> NDArray[np.int32]:
    """Label the connected components of a graph of nodes 0..count - 1.

    Args:
        count: number of nodes.
        first: one node of each edge, [E].
        second: the other node of each edge, [E].

    Returns:
        Number of each node's component, int32 [count], from 0 in the order of their first nodes.
    """
    edges = coo_array((np.ones(len(first), bool), (first, second)), (count, count))
    return np.asarray(connected_components(edges, directed=False)[1], np.int32)
