# SPDX-License-Identifier: GPL-3.0-or-later
"""Find openings in the depth map of a wall: rectangles, or arched ones, at which the mesh lies behind its plane.

The mesh slopes from the wall into an opening, over several pixels and never evenly, and panes are worse: where they
mirror, the mesh lies far behind them, has holes, or comes forward to the wall. Each edge is put where half of the rows
that cross it are half as deep as the opening; where its middle is uneven, where a quarter of them are half as deep as
most of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.boxes import box_areas, intersection_areas
from mgf_engine.openings.arches import ArchOptions, arch_drop, contour_rise, crown_above
from mgf_engine.openings.photo_edges import OpeningEdgeOptions
from mgf_engine.options.algorithms import parameter

Array = NDArray[np.float64]


@dataclass(frozen=True)
class OpeningDetectionOptions:
    """Options of openings that are found by their depth in a wall."""

    depth: float = parameter(1.0, "Minimum depth behind the wall", "ground px", low=0.1)
    noise: float = parameter(
        2.5, "Minimum depth behind the wall in standard deviations of the wall about its plane; twice `depth` at most"
    )
    deepest: float = parameter(14.0, "Depth from which an opening is a passage, however deep", "ground px")
    holes: float = parameter(
        0.8,
        "Minimum share of the surroundings of a hole in the mesh that is deep, so that the hole counts as deep",
        high=1,
    )
    middle: float = parameter(0.2, "Margin around an opening's middle, as a share of its sides", high=0.45)
    uneven: float = parameter(0.75, "Median deviation of the middle's depth from which it is a pane that mirrors",
                              "ground px")  # fmt: skip
    bottom: tuple[float, float] = parameter(
        (0.5, 0.35), "Quantile of depths that is the depth of an opening, and of one whose pane mirrors", high=1
    )
    crossing: tuple[float, float] = parameter(
        (0.5, 0.25), "Share of the rows across an edge that are deep on its inner side, of an opening, and of "
        "such a one", high=1,
    )  # fmt: skip
    shape: float = parameter(1.0, "Maximum depth, as a share of the shorter side")
    side: float = parameter(10.0, "Minimum length of a side", "ground px")
    filled: tuple[float, float] = parameter(
        (0.8, 0.65), "Minimum share of the rectangle that is half as deep or deeper, of an opening, and of such a one",
        high=1,
    )  # fmt: skip
    corners: float = parameter(
        0.3, "Minimum share that is deep of three of its corners; a round window has none", high=1
    )
    corner_side: float = parameter(30.0, "Length of the shorter side from which the corners count", "ground px")
    around: float = parameter(0.7, "Minimum share of its surroundings that is wall", high=1)
    largest: float = parameter(0.4, "Maximum area, as a share of the wall's", high=1)
    doubled: float = parameter(
        0.1, "Minimum share of the smaller one's area that two openings share, so that only one is kept", high=1
    )
    aligned: float = parameter(3.0, "Distance within which edges of openings are put on one line", "ground px")
    edges: OpeningEdgeOptions = OpeningEdgeOptions()
    arches: ArchOptions = ArchOptions()


class Opening(NamedTuple):
    """An opening in the depth map of a wall.

    Attributes:
        score: how much like a rectangle, or an arched opening, it is, 0..1.
        box: left, top, right, bottom in pixels of the map, [4]; the top is that of a level head.
        depth: of its bottom behind the wall, unit of the map; infinite for a passage.
        rise: of an arched head that its contour has, in pixels of the map; 0 without.
        level: whether a level head is possible.
    """

    score: float
    box: Array
    depth: float
    rise: float = 0.0
    level: bool = True


def openings_in(
    depth: NDArray[np.float32], pixel: float, resolution: float, area: float, options: OpeningDetectionOptions
) -> Iterator[Opening]:
    """Yield the openings in the depth map of a wall.

    Args:
        depth: behind the wall's plane at each pixel, any unit, NaN where nothing is seen, [H, W].
        pixel: a ground pixel, same unit.
        resolution: side of a pixel of the map, same unit; the rectangles are in these pixels.
        area: of the wall, in pixels of the map.
        options: what counts as an opening.
    """
    pixel /= resolution
    margin, deepest = round(options.side * pixel) + 1, np.float32(options.deepest * pixel)
    depth = np.minimum(depth / np.float32(resolution), deepest)
    least = options.depth * pixel
    least = float(np.clip(options.noise * _deviation(depth, 3 * least), least, 2 * least))
    depth = _closed(depth, least, options.holes)
    depth = np.pad(depth, margin, constant_values=np.nan)  # what is beyond the map is no wall
    deep = (depth > least).astype(np.uint8)
    _, part, stats, _ = cv2.connectedComponentsWithStats(deep, connectivity=4)
    for k, (x, y, w, h, count) in enumerate(stats.tolist()):
        if k == 0 or count > options.largest * area or min(w, h) < 0.5 * options.side * pixel:
            continue
        near = slice(y - margin, y + h + margin), slice(x - margin, x + w + margin)
        found = _fit_best(depth[near], part[near] == k, pixel, options)
        if found is not None:
            shift = np.array([x, y, x, y]) - 2 * margin
            bottom = found.depth * resolution if found.depth < deepest else np.inf
            yield found._replace(box=found.box + shift, depth=bottom)


def _deviation(depth: NDArray[np.float32], near: float) -> float:
    """Return the standard deviation of a map's pixels within a distance of the plane, by their median (MAD)."""
    wall = np.abs(depth[np.abs(depth) < near])
    return 1.4826 * float(np.median(wall)) if len(wall) else 0.0


def _fit_best(
    depth: NDArray[np.float32], part: NDArray[np.bool_], pixel: float, options: OpeningDetectionOptions
) -> Opening | None:
    """Fit an opening to a deep part of a map as :func:`_fit` does; with a pane that mirrors if its middle is uneven."""
    found = _fit(depth, part, pixel, 0, options)
    if found is not None:
        middle = _middle(depth, found.box, options.middle)
        if np.nanmedian(np.abs(middle - found.depth)) <= options.uneven * pixel:
            return found
    return _fit(depth, part, pixel, 1, options) or found


def _fit(
    depth: NDArray[np.float32], part: NDArray[np.bool_], pixel: float, pane: int, options: OpeningDetectionOptions
) -> Opening | None:
    """Fit an opening to a deep part of a map.

    Args:
        depth: map around the part, pixels of the map, [H, W].
        part: its pixels, [H, W].
        pixel: a ground pixel, in pixels of the map.
        pane: 0 for an opening, 1 for one whose pane mirrors.
        options: limits.

    Returns:
        In pixels of the map; None if the part is like no opening.
    """
    side, (rows, columns) = options.side * pixel, np.nonzero(part)
    bottom = float(np.quantile(depth[part], options.bottom[pane]))
    share = depth / np.float32(bottom)
    box = (int(columns.min()), int(rows.min()), int(columns.max()) + 1, int(rows.max()) + 1)
    rectangle = _edges(share, box, round(side), 1 - options.crossing[pane])
    shortest = float((rectangle[2:] - rectangle[:2]).min())
    if shortest < side or bottom > options.shape * shortest:
        return None
    rounded = shortest < options.corner_side * pixel  # the mesh rounds corners by some pixels

    def score(rise: float) -> float:
        filled, corners, around = _filling(share, rectangle, side, rise)
        enough = filled >= options.filled[pane] and around >= options.around
        return filled * around if enough and (rounded or corners >= options.corners) else 0.0

    rise = contour_rise(share, rectangle, pixel, options.arches)
    level, arched = score(0.0), score(rise) if rise else 0.0
    if not level and not arched:
        return None
    inner = _middle(depth, rectangle, options.middle)
    bottom = float(np.nanquantile(inner, options.bottom[pane]))
    return Opening(level or arched, rectangle, bottom, rise if arched else 0.0, level > 0)


def _middle(depth: NDArray[np.float32], box: Array, margin: float) -> NDArray[np.float32]:
    """Return the middle of a map [H, W] within left, top, right, bottom, less a margin in shares of their distances."""
    inward = margin * np.tile(box[2:] - box[:2], 2) * np.array([1, 1, -1, -1])
    left, top, right, bottom = np.rint(box + inward).astype(int)
    return depth[top:bottom, left:right]


def _closed(depth: NDArray[np.float32], deep: float, share: float) -> NDArray[np.float32]:
    """Return a depth map [H, W] whose holes (NaN), where they lie within what is deep, have the depth around them.

    Args:
        depth: behind the wall, any unit.
        deep: depth from which a pixel counts as deep, same unit.
        share: minimum share of the pixels around a hole that is deep.
    """
    result = depth.copy()
    _, part, stats, _ = cv2.connectedComponentsWithStats(np.isnan(depth).astype(np.uint8), connectivity=4)
    height, width = depth.shape
    for k, (x, y, w, h, _) in enumerate(stats.tolist()):
        if k == 0 or min(x, y) == 0 or x + w == width or y + h == height:
            continue
        near = slice(y - 1, y + h + 1), slice(x - 1, x + w + 1)
        hole = part[near] == k
        around = depth[near][(cv2.dilate(hole.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0) & ~hole]
        if (around > deep).mean() >= share:
            result[near][hole] = np.nanmedian(around)
    return result


def _edges(share: NDArray[np.float32], box: tuple[int, int, int, int], reach: int, quantile: float) -> Array:
    """Put the edges of a box [left, top, right, bottom] where a quantile of the depth's share crosses a half."""
    left, top, right, bottom = box
    height, width = share.shape
    rows = slice(top + (bottom - top) // 5, bottom - (bottom - top) // 5)
    columns = slice(left + (right - left) // 5, right - (right - left) // 5)
    seen = np.nan_to_num(share)
    across = np.quantile(seen[rows, max(0, left - reach) : min(width, right + reach)], quantile, axis=0)
    down = np.quantile(seen[max(0, top - reach) : min(height, bottom + reach), columns], quantile, axis=1)
    x, y = _crossings(across), _crossings(down)
    low = np.array([max(0, left - reach), max(0, top - reach)])
    return np.array([x[0] + low[0], y[0] + low[1], x[1] + low[0], y[1] + low[1]])


def _crossings(profile: NDArray[np.floating]) -> tuple[float, float]:
    """Find the positions in pixels at which the longest run of a profile [n] above a half begins and ends."""
    on = np.flatnonzero(profile >= 0.5)
    if not len(on):
        return 0.5 * len(profile), 0.5 * len(profile)
    run = max(np.split(on, np.flatnonzero(np.diff(on) > 1) + 1), key=len)
    first, last = int(run[0]), int(run[-1])
    begin, end = float(first), float(last + 1)
    if first > 0:
        begin = first + 0.5 - float((profile[first] - 0.5) / (profile[first] - profile[first - 1]))
    if last < len(profile) - 1:
        end = last + 0.5 + float((profile[last] - 0.5) / (profile[last] - profile[last + 1]))
    return begin, end


def _filling(share: NDArray[np.float32], rectangle: Array, side: float, rise: float) -> tuple[float, float, float]:
    """Return the share of an opening that is deep, of its corner that is so third best, of an arched one's lower corner
    that is so second best, and of its surroundings that is wall."""
    margin = max(2, round(0.4 * side))
    left, top, right, bottom = np.rint(rectangle).astype(int)
    rows = np.arange(max(0, top - margin), min(share.shape[0], bottom + margin))[:, None]
    columns = np.arange(max(0, left - margin), min(share.shape[1], right + margin))[None]
    near = share[rows, columns]
    inside = (rows >= top) & (rows < bottom) & (columns >= left) & (columns < right)
    gap = max(1, margin // 3)  # the slope
    beside = (rows < top - gap) | (rows >= bottom + gap) | (columns < left - gap) | (columns >= right + gap)
    wall, deep = np.abs(near[beside]) < 0.5, near >= 0.5
    if rise:
        width = right - left
        away = columns + 0.5 - 0.5 * (left + right)
        inside &= rows + 0.5 > top - crown_above(width, rise) + arch_drop(away, width, rise)
    high, wide = max(1, (bottom - top) // 6), max(1, (right - left) // 6)
    lower, upper = rows >= bottom - high, rows < top + high
    corners = sorted(
        float(deep[inside & end & side].mean())
        for end in ((lower,) if rise else (upper, lower))
        for side in (columns < left + wide, columns >= right - wide)
    )
    corner = corners[0] if rise else corners[1]
    return float(deep[inside].mean()), corner, float(wall.mean()) if wall.size else 0.0


def without_doubles(found: Sequence[Opening], share: float = OpeningDetectionOptions().doubled) -> list[int]:
    """Return the places of openings that overlap none of a higher score (non-maximum suppression), best first.

    Two overlap where they have this share of the smaller one's area in common: a pane in its window is dropped, too.
    """
    kept = list[int]()
    for place in sorted(range(len(found)), key=lambda k: -found[k].score):
        others, this = np.array([found[k].box for k in kept]).reshape(-1, 4), found[place].box[None]
        smaller = np.minimum(box_areas(others), box_areas(this))
        if (intersection_areas(this, others)[0] < share * smaller).all():
            kept.append(place)
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
