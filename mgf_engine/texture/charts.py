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
from mgf_engine.texture.model import NO_VIEW, Layout, painting_views
from mgf_engine.texture.packing import pack

CELL = 6  # px; side of the square that a face without photo gets: the least that keeps a colour when filtered
LEAST_SIDE = 256  # px of the picture
JPEG_UNIT = 16  # px; the picture's height is a multiple, as JPEG stores it
_TRIES = 12  # of a bisection: the scale to 1/4096

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ChartOptions:
    """Options of the layout of the texture."""

    gutter: int = parameter(3, "Width of the gutter around each patch, filled with its own colours", "px", low=1)


def merge_patches(
    uv: Array, label: NDArray[np.int32], patch: NDArray[np.int32], options: ChartOptions = ChartOptions()
) -> NDArray[np.int32]:
    """Merge patches of one photo into charts where a common rectangle takes less room, int32 [F].

    Patches of one photo lie beside each other in it, so that small ones fit into the gaps of larger ones.

    Args:
        uv: [F, 3, 2], corners in pixels of the view that paints each face.
        label: view that paints each face, [F].
        patch: of each face, [F], as :func:`mgf_engine.texture.view_selection.patches` returns it.
        options: the gutter that each rectangle needs.
    """
    low, high = _bounds(uv, patch, int(patch.max(initial=-1)) + 1)
    view = np.zeros(len(low), np.int32)
    view[patch] = label
    chart = np.arange(len(low), dtype=np.int32)
    for index in painting_views(view):
        rows = np.flatnonzero(view == index)
        chart[rows] = rows[_merge_rectangles(low[rows] - options.gutter, high[rows] + options.gutter)]
    return chart[patch]


def _bounds(uv: Array, group: NDArray[np.integer], count: int) -> tuple[Array, Array]:
    """Return the least and the largest corner of each group of faces, [count, 2] each."""
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, group, uv.min(1))
    np.maximum.at(high, group, uv.max(1))
    return low, high


def _merge_rectangles(low: Array, high: Array) -> NDArray[np.int64]:
    """Merge rectangles, from the largest to the smallest, each into the one where that saves most: the first rectangle
    of each one's group, [N]."""
    area = (high - low).prod(1)
    group, kept, count = np.arange(len(low)), np.empty(len(low), np.int64), 0
    left, top, right, bottom, room = np.empty((5, len(low)))  # of the rectangles so far; rows, since that is faster
    for i in np.argsort(-area, kind="stable").tolist():
        own = (*low[i].tolist(), *high[i].tolist(), float(area[i]))
        at = count
        if count:
            wide = np.maximum(right[:count], own[2]) - np.minimum(left[:count], own[0])
            tall = np.maximum(bottom[:count], own[3]) - np.minimum(top[:count], own[1])
            saved = room[:count] - wide * tall
            best = int(saved.argmax())
            if saved[best] + own[4] > 0:
                at, group[i] = best, kept[best]
                own = (
                    min(own[0], left[at]), min(own[1], top[at]), max(own[2], right[at]), max(own[3], bottom[at]),
                    float(wide[at] * tall[at]),
                )  # fmt: skip
        if at == count:
            kept[at], count = i, count + 1
        left[at], top[at], right[at], bottom[at], room[at] = own
    return group


def lay_out(
    uv: Array,
    label: NDArray[np.int32],
    chart: NDArray[np.int32],
    finest: float,
    largest_side: int,
    options: ChartOptions = ChartOptions(),
) -> Layout:
    """Place all faces in a picture, as large as the photos allow and the picture has room for.

    Args:
        uv: [F, 3, 2], corners in pixels of the view that paints each face; ignored for faces without one.
        label: view that paints each face, [F], as :func:`mgf_engine.texture.view_selection.choose_views` returns it.
        chart: of each face, [F], as :func:`merge_patches` returns it; ignored for faces without view.
        finest: pixels of the user's photos per pixel of the working photos.
        largest_side: of the picture, pixels.
        options: of the layout.
    """
    painted = np.flatnonzero(label != NO_VIEW)
    which, group = np.unique(chart[painted], return_inverse=True)
    low, high = _bounds(uv[painted], group, len(which))
    bare = np.flatnonzero(label == NO_VIEW)

    def rectangles(scale: float) -> NDArray[np.int64]:
        sizes = (np.ceil(high * scale) - np.floor(low * scale)).astype(np.int64) + 2 * options.gutter
        square = CELL * int(np.ceil(np.sqrt(len(bare))))
        return np.concatenate([sizes, [[square, square]]]) if len(bare) else sizes

    side, scale = _fit(rectangles, finest, largest_side)
    sizes = rectangles(scale)
    corner = pack(sizes, side)
    assert corner is not None
    at = np.empty((len(label), 3, 2))
    # Whole pixels of the photo are cut off, so that pixels of the photo are copied and not interpolated.
    at[painted] = uv[painted] * scale + (corner[group] + options.gutter - np.floor(low * scale)[group])[:, None]
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


def _cells(count: int) -> Array:
    """Place triangles [count, 3, 2], each in the middle of its square cell, row by row."""
    columns = int(np.ceil(np.sqrt(count)))
    row, column = np.divmod(np.arange(count), columns)
    reach = CELL - 1.5
    triangle = np.array([[1.5, 1.5], [reach, 1.5], [1.5, reach]])
    return triangle + CELL * np.stack([column, row], 1)[:, None]
