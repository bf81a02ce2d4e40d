# SPDX-License-Identifier: GPL-3.0-or-later
"""Windows, doors and niches of an elevation: rectangles at which the mesh lies behind the plane of a wall.

The mesh slopes from the wall into an opening, over several pixels and never evenly. Each edge is put where the median
over the rows that cross it is half as deep as the opening, which does not depend on where a region's border frays. The
photos then say where between wall and bottom the edge is (:mod:`mgf_engine.drawings.opening_edges`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects

from mgf_engine.drawings.model import Array
from mgf_engine.drawings.opening_edges import EdgePhotos, OpeningEdgeOptions, move_edges
from mgf_engine.drawings.project import GridBuffers
from mgf_engine.drawings.rectangles import align_edges
from mgf_engine.drawings.regions import RegionMap
from mgf_engine.geometry.boxes import box_areas, intersection_areas
from mgf_engine.options.algorithms import parameter


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
    wall: float = parameter(0.02, "Minimum area of a wall, as a share of what the drawing shows", high=1)
    facing: float = parameter(0.97, "Smallest cosine between the normals of wall and drawing", high=1)
    edges: OpeningEdgeOptions = OpeningEdgeOptions()


def find_openings(
    regions: RegionMap,
    seen: GridBuffers,
    pixel: float,
    options: WallOpeningOptions = WallOpeningOptions(),
    photos: EdgePhotos | None = None,
) -> list[Array]:
    """Find openings: left, top, right, bottom of each in pixels of the map [4].

    Args:
        regions: of the elevation, with their planes.
        seen: the mesh at the pixels of the same map.
        pixel: a ground pixel, local unit.
        options: what counts as an opening.
        photos: to take edges from; None leaves them where the mesh has them.
    """
    found = list[tuple[float, Array, int]]()
    for wall, depth, box, area in _walls(regions, seen, options):
        for score, rectangle in _in_wall(depth, pixel, regions.grid.resolution, area, options):
            found.append((score, rectangle + np.tile([box[1].start, box[0].start], 2), wall))
    kept = _without_doubles(found)
    boxes, within = np.array([box for box, _ in kept]).reshape(-1, 4), options.aligned * pixel / regions.grid.resolution
    boxes = align_edges(boxes, within)
    if photos is None or not len(boxes):
        return list(boxes)
    moved = move_edges(boxes, [wall for _, wall in kept], regions, pixel, photos, options.edges)
    return list(align_edges(moved, 0.5 * within))


def _walls(
    regions: RegionMap, seen: GridBuffers, options: WallOpeningOptions
) -> Iterator[tuple[int, NDArray[np.float32], tuple[slice, slice], int]]:
    """Yield each wall's label, depth map (behind its plane; NaN where nothing is seen), box in the map, and area."""
    label = np.where(regions.label > len(regions.slope), 0, regions.label)
    shown = int((seen.face >= 0).sum())
    for value, box in enumerate(find_objects(label), start=1):
        area = 0 if box is None else int((label[box] == value).sum())
        if area < options.wall * shown or regions.normal(value)[2] < options.facing:
            continue
        rows, columns = np.mgrid[box]
        at = regions.grid.places(np.stack([columns, rows], -1).reshape(-1, 2) + 0.5)
        depth = (regions.before(value, at).reshape(rows.shape) - seen.before[box]).astype(np.float32)
        yield value, depth, box, area


def _in_wall(
    depth: NDArray[np.float32], pixel: float, resolution: float, area: int, options: WallOpeningOptions
) -> Iterator[tuple[float, Array]]:
    """Yield the openings in a depth map [H, W]: how much like a rectangle each is, and left, top, right, bottom in
    pixels."""
    side = options.side * pixel / resolution
    deep = (depth > options.depth * pixel).astype(np.uint8)
    _, part, stats, _ = cv2.connectedComponentsWithStats(deep, connectivity=4)
    for k, (x, y, w, h, count) in enumerate(stats.tolist()):
        if k == 0 or count > options.largest * area or min(w, h) < 0.5 * side:
            continue
        own = depth[y : y + h, x : x + w][part[y : y + h, x : x + w] == k]
        bottom = float(np.median(own))
        share = depth / np.float32(bottom)
        rectangle = _edges(share, (x, y, x + w, y + h), round(side))
        size = rectangle[2:] - rectangle[:2]
        if size.min() >= side and bottom <= options.shape * size.min() * resolution:
            filled, corners, around = _filling(share, rectangle, side)
            if size.min() * resolution < options.corner_side * pixel:  # the mesh rounds corners by some pixels
                corners = 1.0
            if filled >= options.filled and corners >= options.corners and around >= options.around:
                yield filled * around, rectangle


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


def _without_doubles(found: list[tuple[float, Array, int]]) -> list[tuple[Array, int]]:
    """Drop rectangles that overlap one of a higher score (non-maximum suppression); each with its wall.

    Two overlap where they share 0.3 of the smaller one's area: a pane in its window is dropped, too.
    """
    kept = list[tuple[Array, int]]()
    for _, box, wall in sorted(found, key=lambda entry: -entry[0]):
        others, this = np.array([other for other, _ in kept]).reshape(-1, 4), box[None]
        smaller = np.minimum(box_areas(others), box_areas(this))
        if (intersection_areas(this, others)[0] < 0.3 * smaller).all():
            kept.append((box, wall))
    return kept
