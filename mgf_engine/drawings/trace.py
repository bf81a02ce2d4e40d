# SPDX-License-Identifier: GPL-3.0-or-later
"""Borders of regions as chains of pixel corners between the places where three or more regions meet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Chain:
    """A border between two regions.

    Attributes:
        corners: float64 [n, 2], columns and rows of pixel corners in order; the first again at the end of a loop.
        low, high: the labels on its sides, the smaller one first.
        ends: numbers of the places where it begins and ends; equal for loops.
    """

    corners: NDArray[np.float64]
    low: int
    high: int
    ends: tuple[int, int]

    @property
    def closed(self) -> bool:
        return self.ends[0] == self.ends[1]


def trace(label: NDArray[np.int32]) -> list[Chain]:
    """Return all borders of a label map [H, W]."""
    width = label.shape[1] + 1
    first, second, low, high = _cracks(label, width)
    if not len(first):
        return []
    ends = np.concatenate([first, second])
    nodes, place, degree = np.unique(ends, return_inverse=True, return_counts=True)
    start, count = np.cumsum(degree) - degree, len(first)
    around = np.argsort(place, kind="stable") % count
    plain = degree == 2  # two sides with a border around a corner: two labels, so that one border passes
    used = np.zeros(count, bool)
    at = [place[:count].tolist(), place[count:].tolist()]
    edges, begin, passed = around.tolist(), start.tolist(), plain.tolist()

    def follow(edge: int, node: int) -> list[int]:
        """Return the nodes from ``node`` along ``edge`` to the next that is not plain, or round to the first."""
        path = [node]
        while True:
            used[edge] = True
            node = at[1][edge] if at[0][edge] == node else at[0][edge]
            path.append(node)
            if not passed[node] or node == path[0]:
                return path
            one, two = edges[begin[node]], edges[begin[node] + 1]
            edge = two if one == edge else one

    chains = []
    for node in np.flatnonzero(~plain).tolist():
        for edge in edges[begin[node] : begin[node] + int(degree[node])]:
            if not used[edge]:
                chains.append((follow(edge, node), edge))
    for edge in range(count):
        if not used[edge]:
            chains.append((follow(edge, at[0][edge]), edge))
    return [_chain(nodes[path], int(low[edge]), int(high[edge]), width) for path, edge in chains]


def _cracks(
    label: NDArray[np.int32], width: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int32], NDArray[np.int32]]:
    """Return the sides of pixels between two labels: the corners at both ends (numbers), and the labels, smaller
    first."""
    row, column = np.nonzero(label[:, 1:] != label[:, :-1])
    down = row * width + column + 1
    beside = label[row, column], label[row, column + 1]
    row, column = np.nonzero(label[1:] != label[:-1])
    across = (row + 1) * width + column
    above = label[row, column], label[row + 1, column]
    a, b = (np.concatenate([one, two]) for one, two in zip(beside, above, strict=True))
    first, second = np.concatenate([down, across]), np.concatenate([down + width, across + 1])
    return first.astype(np.int64), second.astype(np.int64), np.minimum(a, b), np.maximum(a, b)


def _chain(nodes: NDArray[np.int64], low: int, high: int, width: int) -> Chain:
    row, column = np.divmod(nodes, width)
    return Chain(np.stack([column, row], 1).astype(np.float64), low, high, (int(nodes[0]), int(nodes[-1])))
