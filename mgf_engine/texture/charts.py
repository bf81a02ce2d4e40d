# SPDX-License-Identifier: GPL-3.0-or-later
"""Charts of the texture atlas: patches of faces as they appear in their photo, packed as rectangles.

Faces that no photo shows get a small triangle each, all of one size, in a rectangle of their own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.options.algorithms import parameter
from mgf_engine.texture.model import NO_VIEW, Layout

CELL = 6  # px; side of the square that a face without photo gets: the least that keeps a colour when filtered
LEAST_SIDE = 256  # px of the picture
JPEG_UNIT = 16  # px; the picture's height is a multiple, as JPEG stores it
_TRIES = 12  # of a bisection: the scale to 1/4096

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ChartOptions:
    """Options of the layout of the texture."""

    gutter: int = parameter(3, "Width of the gutter around each patch, filled with its own colours", "px", low=1)


def lay_out(
    uv: Array,
    label: NDArray[np.int32],
    patch: NDArray[np.int32],
    finest: float,
    largest_side: int,
    options: ChartOptions = ChartOptions(),
) -> Layout:
    """Place all faces in a picture, as large as the photos allow and the picture has room for.

    Args:
        uv: [F, 3, 2], corners in pixels of the view that paints each face; ignored for faces without one.
        label: view that paints each face, [F], as :func:`mgf_engine.texture.view_selection.choose_views` returns it.
        patch: of each face, [F], as :func:`mgf_engine.texture.view_selection.patches` returns it.
        finest: pixels of the user's photos per pixel of the working photos.
        largest_side: of the picture, pixels.
        options: of the layout.
    """
    painted = np.flatnonzero(label != NO_VIEW)
    which, group = np.unique(patch[painted], return_inverse=True)
    low, high = np.full((len(which), 2), np.inf), np.full((len(which), 2), -np.inf)
    np.minimum.at(low, group, uv[painted].min(1))
    np.maximum.at(high, group, uv[painted].max(1))
    bare = np.flatnonzero(label == NO_VIEW)

    def rectangles(scale: float) -> NDArray[np.int64]:
        sizes = np.ceil((high - low) * scale).astype(np.int64) + 2 * options.gutter
        square = CELL * int(np.ceil(np.sqrt(len(bare))))
        return np.concatenate([sizes, [[square, square]]]) if len(bare) else sizes

    side, scale = _fit(rectangles, finest, largest_side)
    sizes = rectangles(scale)
    corner = pack(sizes, side)
    assert corner is not None
    at = np.empty((len(label), 3, 2))
    at[painted] = (uv[painted] - low[group][:, None]) * scale + corner[group][:, None] + options.gutter
    if len(bare):
        at[bare] = _cells(len(bare)) + corner[-1]
    height = int((corner + sizes)[:, 1].max(initial=1))
    return Layout(side, -(-height // JPEG_UNIT) * JPEG_UNIT, at, scale)


def _fit(rectangles: Callable[[float], NDArray[np.int64]], finest: float, largest: int) -> tuple[int, float]:
    """Find the side of the picture and the scale: the finest in the smallest picture, else what the largest has room
    for."""
    side = min(LEAST_SIDE, largest)
    while side <= largest:
        if pack(rectangles(finest), side) is not None:
            return side, finest
        if side == largest:
            break
        side = min(2 * side, largest)
    while pack(rectangles(0.0), side) is None:  # more faces without photo than there are cells: rather a larger picture
        side *= 2
    low, high = 0.0, finest
    for _ in range(_TRIES):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if pack(rectangles(middle), side) is not None else (low, middle)
    return side, low


def pack(sizes: NDArray[np.int64], side: int) -> NDArray[np.int64] | None:
    """Pack rectangles [N, 2] (width, height) into a square, on shelves: their top-left corners [N, 2]; None where they
    do not fit.

    The highest come first, so that a shelf is as high as its first rectangle and hardly wasted by the others.
    """
    corner = np.zeros_like(sizes)
    x = y = shelf = 0
    for i in np.lexsort((-sizes[:, 0], -sizes[:, 1])).tolist():
        width, height = sizes[i].tolist()
        if x + width > side:
            x, y, shelf = 0, y + shelf, 0
        shelf = max(shelf, height)
        if width > side or y + shelf > side:
            return None
        corner[i] = x, y
        x += width
    return corner


def _cells(count: int) -> Array:
    """Place triangles [count, 3, 2], each in the middle of its square cell, row by row."""
    columns = int(np.ceil(np.sqrt(count)))
    row, column = np.divmod(np.arange(count), columns)
    reach = CELL - 1.5
    triangle = np.array([[1.5, 1.5], [reach, 1.5], [1.5, reach]])
    return triangle + CELL * np.stack([column, row], 1)[:, None]
