# SPDX-License-Identifier: GPL-3.0-or-later
"""Find openings in the depth map of a wall: rectangles at which the mesh lies behind the wall's plane.

The mesh slopes from the wall into an opening, over several pixels and never evenly. Each edge is put where the median
over the rows that cross it is half as deep as the opening, which does not depend on where a border frays.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.boxes import box_areas, intersection_areas
from mgf_engine.openings.photo_edges import OpeningEdgeOptions
from mgf_engine.options.algorithms import parameter

Array = NDArray[np.float64]


@dataclass(frozen=True)
class WallOpeningOptions:
    """Options of openings that are found by their depth in a wall."""

    depth: float = parameter(1.0, "Minimum depth behind the wall", "ground px", low=0.1)
    shape: float = parameter(1.0, "Maximum depth, as a share of the shorter side")
    side: float = parameter(10.0, "Minimum length of a side", "ground px")
    filled: float = parameter(0.8, "Minimum share of the rectangle that is half as deep or deeper", high=1)
    corners: float = parameter(0.3, "Minimum share of its corners that is; a round window has none", high=1)
    corner_side: float = parameter(30.0, "Length of the shorter side from which the corners count", "ground px")
    around: float = parameter(0.7, "Minimum share of its surroundings that is wall", high=1)
    largest: float = parameter(0.25, "Maximum area, as a share of the wall's", high=1)
    aligned: float = parameter(3.0, "Distance within which edges of openings are put on one line", "ground px")
    edges: OpeningEdgeOptions = OpeningEdgeOptions()


class Found(NamedTuple):
    """An opening in a wall.

    Attributes:
        score: how much like a rectangle it is, 0..1.
        box: left, top, right, bottom in pixels of the map, [4].
        wall: number of the wall.
    """

    score: float
    box: Array
    wall: int


def openings_in(
    depth: NDArray[np.float32], pixel: float, resolution: float, area: float, options: WallOpeningOptions
) -> Iterator[tuple[float, Array]]:
    """Yield the openings in the depth map of a wall: how much like a rectangle each is, and left, top, right, bottom.

    Args:
        depth: behind the wall's plane at each pixel, any unit, NaN where nothing is seen, [H, W].
        pixel: a ground pixel, same unit.
        resolution: side of a pixel of the map, same unit; the rectangles are in these pixels.
        area: of the wall, in pixels of the map.
        options: what counts as an opening.
    """
    side = options.side * pixel / resolution
    margin = round(side) + 1
    deep = (depth > options.depth * pixel).astype(np.uint8)
    _, part, stats, _ = cv2.connectedComponentsWithStats(deep, connectivity=4)
    for k, (x, y, w, h, count) in enumerate(stats.tolist()):
        if k == 0 or count > options.largest * area or min(w, h) < 0.5 * side:
            continue
        x0, y0 = max(0, x - margin), max(0, y - margin)
        near = slice(y0, y + h + margin), slice(x0, x + w + margin)
        bottom = float(np.median(depth[near][part[near] == k]))
        share = depth[near] / np.float32(bottom)
        rectangle = _edges(share, (x - x0, y - y0, x + w - x0, y + h - y0), round(side))
        size = rectangle[2:] - rectangle[:2]
        if size.min() >= side and bottom <= options.shape * size.min() * resolution:
            filled, corners, around = _filling(share, rectangle, side)
            if size.min() * resolution < options.corner_side * pixel:  # the mesh rounds corners by some pixels
                corners = 1.0
            if filled >= options.filled and corners >= options.corners and around >= options.around:
                yield filled * around, rectangle + np.array([x0, y0, x0, y0])


def _edges(share: NDArray[np.float32], box: tuple[int, int, int, int], reach: int) -> Array:
    """Put the edges of a box [left, top, right, bottom] where the depth's share crosses a half; from its middle on."""
    left, top, right, bottom = box
    height, width = share.shape
    rows = slice(top + (bottom - top) // 5, bottom - (bottom - top) // 5)
    columns = slice(left + (right - left) // 5, right - (right - left) // 5)
    seen = np.nan_to_num(share)
    across = np.median(seen[rows, max(0, left - reach) : min(width, right + reach)], axis=0)
    down = np.median(seen[max(0, top - reach) : min(height, bottom + reach), columns], axis=1)
    x, y = _crossings(across), _crossings(down)
    low = np.array([max(0, left - reach), max(0, top - reach)])
    return np.array([x[0] + low[0], y[0] + low[1], x[1] + low[0], y[1] + low[1]])


def _crossings(profile: NDArray[np.float32]) -> tuple[float, float]:
    """Find the positions left and right of its middle at which a profile [n] first crosses a half, in pixels."""
    middle = len(profile) // 2
    if profile[middle] < 0.5:
        return float(middle), float(middle)
    first = next((k for k in range(middle, -1, -1) if profile[k] < 0.5), -1)
    last = next((k for k in range(middle, len(profile)) if profile[k] < 0.5), len(profile))
    begin, end = float(first + 1), float(last)
    if first >= 0:
        begin = first + 0.5 + float((0.5 - profile[first]) / (profile[first + 1] - profile[first]))
    if last < len(profile):
        end = last + 0.5 - float((0.5 - profile[last]) / (profile[last - 1] - profile[last]))
    return begin, end


def _filling(share: NDArray[np.float32], rectangle: Array, side: float) -> tuple[float, float, float]:
    """Return the share of a rectangle that is deep, of its corners that are, and of what is around that is wall."""
    margin = max(2, round(0.4 * side))
    left, top, right, bottom = np.rint(rectangle).astype(int)
    rows = np.arange(max(0, top - margin), min(share.shape[0], bottom + margin))[:, None]
    columns = np.arange(max(0, left - margin), min(share.shape[1], right + margin))[None]
    near = share[rows, columns]
    inside = (rows >= top) & (rows < bottom) & (columns >= left) & (columns < right)
    gap = max(1, margin // 3)  # the slope
    beside = (rows < top - gap) | (rows >= bottom + gap) | (columns < left - gap) | (columns >= right + gap)
    wall, deep = np.abs(near[beside]) < 0.5, near >= 0.5
    high, wide = max(1, (bottom - top) // 6), max(1, (right - left) // 6)
    outer = ((rows < top + high) | (rows >= bottom - high)) & ((columns < left + wide) | (columns >= right - wide))
    shares = (float(deep[inside].mean()), float(deep[inside & outer].mean()))
    return *shares, float(wall.mean()) if wall.size else 0.0


def without_doubles(found: Sequence[Found]) -> list[Found]:
    """Drop rectangles that overlap one of a higher score (non-maximum suppression).

    Two overlap where they share 0.3 of the smaller one's area: a pane in its window is dropped, too.
    """
    kept = list[Found]()
    for one in sorted(found, key=lambda entry: -entry.score):
        others, this = np.array([other.box for other in kept]).reshape(-1, 4), one.box[None]
        smaller = np.minimum(box_areas(others), box_areas(this))
        if (intersection_areas(this, others)[0] < 0.3 * smaller).all():
            kept.append(one)
    return kept


def align_edges(boxes: Array, distance: float) -> Array:
    """Bring edges of rectangles [n, 4] that are within a distance of one line onto it, column by column."""
    result = boxes.copy()
    for k in range(4):
        order = np.argsort(boxes[:, k])
        groups = np.split(order, np.flatnonzero(np.diff(boxes[order, k]) > distance / 2) + 1)
        for group in groups:
            if len(group) and np.ptp(boxes[group, k]) <= distance:
                result[group, k] = boxes[group, k].mean()
    return result
