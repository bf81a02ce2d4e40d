# SPDX-License-Identifier: GPL-3.0-or-later
"""Divide points into the blocks of a grid whose separate Delaunay tetrahedra fit together without seams.

Each border gets points of its own, copies of those beside it, that the blocks at both of its sides share. All points
of a block lie at one side of the border. Then the border supports their hull, and Delaunay tetrahedra meet it in the
Delaunay triangles of the points on it, whatever else the block holds: the lower hull of the lifted points, cut by a
plane that supports it, is the lower hull of those on the plane. So both sides have the same triangles there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_BINS = 256  # of the building's length, among which a border is chosen
_WINDOW = 0.3  # of a block's share of the points: how far from an even share a border may lie
_CELL, _JITTER = 0.25, 0.05  # of a point's extent: side of the cells of a border's points, how far each is moved

Points = NDArray[np.float64]


@dataclass(frozen=True)
class BlockGrid:
    """A grid of blocks; the outer ones have no end.

    Attributes:
        cuts: where the borders across each axis lie, ascending, [K] for each of x, y, z.
    """

    cuts: tuple[Points, Points, Points]

    def __len__(self) -> int:
        return int(np.prod([len(cuts) + 1 for cuts in self.cuts]))

    def boxes(self) -> Iterator[tuple[Points, Points]]:
        """Iterate over the blocks: lowest and highest corner, [3] each, infinite where nothing ends them."""
        limits = [np.r_[-np.inf, cuts, np.inf] for cuts in self.cuts]
        for place in np.ndindex(*(len(limit) - 1 for limit in limits)):
            yield (
                np.array([limit[k] for limit, k in zip(limits, place, strict=True)]),
                np.array([limit[k + 1] for limit, k in zip(limits, place, strict=True)]),
            )

    def members(self, points: Points) -> Iterator[NDArray[np.int64]]:
        """Iterate over the blocks: numbers of the points [N, 3] in each, those on its borders included, ascending."""
        for low, high in self.boxes():
            yield np.flatnonzero(((points >= low) & (points <= high)).all(1))

    def on_border(self, points: Points) -> NDArray[np.bool_]:
        """Tell which coordinates of points [N, 3] are those of a border, bool [N, 3]."""
        return np.stack([np.isin(points[:, axis], self.cuts[axis]) for axis in range(3)], 1)


#: The grid of a single block.
WHOLE = BlockGrid((np.zeros(0), np.zeros(0), np.zeros(0)))


def make_grid(points: Points, count: int) -> BlockGrid:
    """Divide the box around points [N, 3] into ``count`` blocks, the longest sides first.

    Borders leave about as many points at either side, and lie where the fewest points are: not along a wall.
    """
    size, parts = np.ptp(points, axis=0), np.ones(3, np.int64)
    for factor in _prime_factors(count):
        parts[np.argmax(size / parts)] *= factor
    x, y, z = (_cuts(points[:, axis], int(parts[axis])) for axis in range(3))
    return BlockGrid((x, y, z))


def with_borders(points: Points, extent: Points, grid: BlockGrid) -> tuple[Points, Points]:
    """Add points on the borders, where points nearby reach them.

    They are moved along the border a little: where four lay on one circle, either diagonal would do, and the two
    sides could choose differently.

    Args:
        points: [N, 3].
        extent: how far each reaches, [N].
        grid: whose borders.

    Returns:
        All points [M, 3], the given ones first, and their extents [M].
    """
    generator = np.random.default_rng(0)
    for axis, cuts in enumerate(grid.cuts):
        for cut in cuts:
            near = np.flatnonzero(np.abs(points[:, axis] - cut) <= extent)
            copies, reach = points[near], extent[near]
            copies[:, axis] = cut
            fixed = grid.on_border(copies)  # they stay on this border, and on those that it crosses
            cell = max(_CELL * float(np.median(reach)), 1e-300) if len(reach) else 1.0
            key = np.c_[np.where(fixed, copies, np.floor(copies / cell)), fixed]
            kept = np.sort(np.unique(key, axis=0, return_index=True)[1])
            moved = copies[kept] + np.where(fixed[kept], 0.0, _JITTER * cell * generator.uniform(-1, 1, (len(kept), 3)))
            points, extent = np.concatenate([points, moved]), np.concatenate([extent, reach[kept]])
    return points, extent


def _cuts(values: Points, parts: int) -> Points:
    """Choose the borders between ``parts`` parts of an axis, ascending [parts - 1], by the points' coordinates [N]."""
    count, edges = np.histogram(values, _BINS)
    below, middle = np.cumsum(count) / len(values), (edges[1:] + edges[:-1]) / 2
    found = []
    for part in range(1, parts):
        off = np.abs(below - part / parts)
        allowed = off <= max(_WINDOW / parts, off.min())
        # Of bins as empty as each other the one nearest to an even share.
        found.append(middle[np.lexsort((off, np.where(allowed, count, len(values) + 1)))[0]])
    return np.unique(found)


def _prime_factors(number: int) -> list[int]:
    """Return the prime factors of a number, the largest first."""
    found, factor = list[int](), 2
    while number > 1:
        while number % factor == 0:
            found.append(factor)
            number //= factor
        factor += 1
    return found[::-1]
