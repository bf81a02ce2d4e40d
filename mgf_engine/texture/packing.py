# SPDX-License-Identifier: GPL-3.0-or-later
"""Packing of rectangles into a picture: low ones on shelves, shelves and high ones along a skyline.

The skyline is the height that each column is filled to; a rectangle goes where it comes to lie highest up (bottom-left
skyline: Jylänki, A Thousand Ways to Pack the Bin, 2010).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

LOW = 24  # px; rectangles up to this height go on shelves
SHELF = 256  # px; width of a shelf
COLUMN = 2  # px of the skyline's steps

Rectangles = NDArray[np.int64]


def pack(sizes: Rectangles, side: int) -> Rectangles | None:
    """Pack rectangles [N, 2] (width, height) into a square: their top-left corners [N, 2]; None where they do not
    fit."""
    if len(sizes) and sizes[:, 0].max() > side:
        return None
    low = np.flatnonzero((sizes[:, 1] <= LOW) & (sizes[:, 0] <= SHELF))
    high = np.setdiff1d(np.arange(len(sizes)), low)
    shelf, across, shelves = _on_shelves(sizes[low], min(SHELF, side))
    placed = _along_skyline(np.concatenate([sizes[high], shelves]), side)
    if placed is None:
        return None
    corner = np.empty_like(sizes)
    corner[high] = placed[: len(high)]
    corner[low] = placed[len(high) :][shelf]
    corner[low, 0] += across
    return corner


def _on_shelves(sizes: Rectangles, width: int) -> tuple[NDArray[np.int64], NDArray[np.int64], Rectangles]:
    """Return the shelf of each rectangle and where on it, [N] each, and the sizes of the shelves.

    The highest come first, so that a shelf is as high as its first rectangle and hardly wasted by the others.
    """
    shelf, across = np.zeros(len(sizes), np.int64), np.zeros(len(sizes), np.int64)
    shelves: list[list[int]] = []
    for i in np.lexsort((-sizes[:, 0], -sizes[:, 1])).tolist():
        wide, high = sizes[i].tolist()
        if not shelves or shelves[-1][0] + wide > width:
            shelves.append([0, high])
        shelf[i], across[i] = len(shelves) - 1, shelves[-1][0]
        shelves[-1][0] += wide
    return shelf, across, np.array(shelves, np.int64).reshape(-1, 2)


def _along_skyline(sizes: Rectangles, side: int) -> Rectangles | None:
    """Pack rectangles as :func:`pack`, the highest first, each where it comes to lie highest up."""
    columns = side // COLUMN
    filled = np.zeros(columns, np.int64)
    corner = np.zeros_like(sizes)
    for i in np.lexsort((-sizes[:, 0], -sizes[:, 1])).tolist():
        wide, high = -(-int(sizes[i, 0]) // COLUMN), int(sizes[i, 1])
        if wide > columns:
            return None
        top = maximum_filter1d(filled, wide, origin=-(wide // 2))[: columns - wide + 1] if wide > 1 else filled
        first = int(top.argmin())
        bottom = int(top[first]) + high
        if bottom > side:
            return None
        corner[i] = first * COLUMN, bottom - high
        filled[first : first + wide] = bottom
    return corner
