# SPDX-License-Identifier: GPL-3.0-or-later
"""Regions that are sky, or the plain backdrop of a model on a table: they have no place in space.

A white wall and a white sky look alike; what tells them apart is that the sky reaches the top of the photo without an
edge, and that no point of the scene was ever found in it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from mgf_engine.masks.regions import Regions

#: CIELAB steps between regions that the sky may pass; the largest at which it stays free of points is taken.
STEPS = (8.0, 5.0, 3.0, 2.0)
SMOOTH = 1.0  # log of the mean gradient, see :class:`Regions`
#: A piece with more than this share of the points its size would have elsewhere is no sky.
POINTS_SHARE = 0.03
SMALLEST = 0.004  # share of the photo
TOP_SHARE = 0.02  # of the photo's width that a piece must touch at the top


def find_sky(regions: Regions, observed: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of the piece of sky each region belongs to, 0 for none, [S].

    Args:
        observed: regions in which this photo observed sparse points, once for each.
    """
    count = len(regions.area)
    points = np.bincount(observed, minlength=count)
    result = np.zeros(count, np.int64)
    for step in STEPS:
        piece = _pieces(regions, step)
        size = np.bincount(piece, regions.area)
        found = np.bincount(piece, points)
        touching = np.bincount(piece, regions.top)
        good = (size > SMALLEST) & (touching > TOP_SHARE) & (found <= POINTS_SHARE * size * max(len(observed), 1))
        new = good[piece] & (result == 0)
        result[new] = piece[new] + 1 + result.max()
    return _with_rim(regions, result, points)


def _with_rim(regions: Regions, sky: NDArray[np.int64], points: NDArray[np.int64]) -> NDArray[np.int64]:
    """The pieces grown by regions of the same colour beside them: next to an edge no region is smooth."""
    result = sky.copy()
    a, b = np.concatenate([regions.pairs, regions.pairs[:, ::-1]]).T
    colour = np.linalg.norm(regions.features[a, :3] - regions.features[b, :3], axis=1)
    joins = (sky[a] > 0) & (sky[b] == 0) & (colour < STEPS[-1]) & (points[b] == 0)
    result[b[joins]] = sky[a[joins]]
    return result


def _pieces(regions: Regions, step: float) -> NDArray[np.int64]:
    """Smooth regions joined where no edge runs between them: number of the piece, [S]."""
    count = len(regions.area)
    smooth = regions.features[:, 3] <= SMOOTH
    a, b = regions.pairs.T
    open_ = (regions.contrast <= step) & smooth[a] & smooth[b]
    links = coo_matrix((np.ones(int(open_.sum())), (a[open_], b[open_])), shape=(count, count))
    return connected_components(links, directed=False)[1].astype(np.int64)
