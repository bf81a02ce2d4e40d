# SPDX-License-Identifier: GPL-3.0-or-later
"""Arched heads of openings: segments of a circle, up to a semicircle.

A head is told by its rise, the height of its crown above the springing line: 0 is a level lintel, half the width a
semicircle. The contour of the mesh proposes a rise, but its dents have round corners wherever windows are small. The
photos therefore decide: the gradient across the right curve is larger than that across any other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgf_engine.openings.photo_edges import (
    ALONG,
    STEP,
    EdgePhotos,
    EdgeStrip,
    OpeningEdgeOptions,
    compare_gradients,
    wall_side_edge,
)
from mgf_engine.openings.wall_frame import WallFrame
from mgf_engine.options.algorithms import parameter

Array = NDArray[np.float64]
SEMICIRCLE = 0.5  # rise over width
_RISES = np.array([0.0, 0.12, 0.2, 0.28, 0.38, SEMICIRCLE])  # that are tried, over width
_INNER = 0.8  # share of the width over which curves are compared
_LOWEST = 3.0  # how far below the flat head a crown is looked for, and how far above it, ground px
_MEMBERS = 5  # of a row that photos are compared for
_CLIP = 4.0  # deviations of a contour count no more than that, ground px


@dataclass(frozen=True)
class ArchOptions:
    """Options of arched heads."""

    width: float = parameter(15.0, "Minimum width of an opening with an arched head", "ground px")
    rise: float = parameter(2.5, "Minimum rise of an arched head", "ground px")
    contour: float = parameter(
        0.75, "Deviation of the mesh's contour from an arch, as a share of that from a level head, up to which it is "
        "proposed", high=1,
    )  # fmt: skip
    gain: float = parameter(
        1.15, "Minimum gradient of the photos across an arch, as a multiple of that across a level head", low=1
    )
    alike: float = parameter(1.2, "Maximum ratio of the widths of openings in one row that have the same head", low=1)


def arch_drop(away: Array, width: float, rise: float) -> Array:
    """Return how far below its crown an arched head lies, at distances from its middle; one unit.

    Args:
        away: from the middle, [n]; beyond half the width the drop is the rise.
        width: of the opening.
        rise: of the head.
    """
    if rise <= 0:
        return np.zeros_like(away)
    radius = arch_radius(width, rise)
    inside = np.minimum(np.abs(away), 0.5 * width)
    return np.asarray(radius - np.sqrt(np.maximum(radius**2 - inside**2, (radius - rise) ** 2)))


def arch_radius(width: float, rise: float) -> float:
    """Return the radius of an arched head; all in one unit."""
    return (0.25 * width**2 + rise**2) / (2 * rise)


def crown_above(width: float, rise: float) -> float:
    """Return how far a crown lies above the middle height (median) of the inner three fifths of an arched head."""
    return float(arch_drop(np.array([0.15 * width]), width, rise)[0])


def arch_outline(box: Array, rise: float, step: float) -> Array:
    """Return the outline of an opening.

    Args:
        box: left, top (of the crown), right, bottom; y up, [4].
        rise: of its head.
        step: between the points on an arched head.

    Returns:
        Its corners from the left springing over the crown and the right foot to the left one, [n, 2].
    """
    left, top, right, bottom = box
    width = right - left
    away = arch_places(width, rise, step)
    head = np.column_stack([0.5 * (left + right) + away, top - arch_drop(away, width, rise)])
    return np.concatenate([head, [[right, bottom], [left, bottom]]])


def arch_places(width: float, rise: float, step: float) -> Array:
    """Return distances from an opening's middle, from -width / 2 to width / 2, which divide its head evenly along it.

    Args:
        width: of the opening.
        rise: of its head; 0 gives the ends alone.
        step: largest one, roughly.
    """
    if rise <= 0:
        return np.array([-0.5 * width, 0.5 * width])
    radius = arch_radius(width, rise)
    end = float(np.arctan2(0.5 * width, radius - rise))
    places = radius * np.sin(np.linspace(-end, end, 2 * max(2, round(radius * end / step)) + 1))
    places[[0, -1]] = -0.5 * width, 0.5 * width
    return places


def contour_rise(share: NDArray[np.float32], box: Array, pixel: float, options: ArchOptions) -> float:
    """Fit an arched head to the contour of an opening in a map; return its rise, 0 for a level one.

    Args:
        share: depth behind the wall over that of the opening, [H, W].
        box: left, top (of a level head), right, bottom, pixels of the map, [4].
        pixel: a ground pixel, in pixels of the map.
        options: limits.
    """
    left, top, right, bottom = box
    width = right - left
    columns = np.arange(int(np.ceil(left)), int(np.floor(right)))
    start = round(0.5 * (top + bottom))
    rises = width * _RISES
    rises = rises[(rises == 0) | ((rises >= options.rise * pixel) & (rises <= 0.8 * (bottom - top)))]
    if width < options.width * pixel or start < 2 or len(rises) < 2:
        return 0.0
    heights = top - _upper_contour(share[:start, columns])
    away = columns + 0.5 - 0.5 * (left + right)
    deviations = [_deviation(heights + arch_drop(away, width, rise), rise, width, pixel) for rise in rises]
    best = int(np.argmin(deviations))
    return float(rises[best]) if deviations[best] <= options.contour * deviations[0] else 0.0


def _upper_contour(share: NDArray[np.float32]) -> Array:
    """Return the rows at which columns of a map [H, W], from their lower ends up, first fall below a half, [W]."""
    shallow = np.nan_to_num(share) < 0.5
    count = len(share)
    last = np.where(shallow.any(0), count - 1 - shallow[::-1].argmax(0), 0)
    column = np.arange(share.shape[1])
    low, high = np.nan_to_num(share[last, column]), np.nan_to_num(share[np.minimum(last + 1, count - 1), column])
    between = np.divide(0.5 - low, high - low, out=np.full(len(low), 0.5), where=high > low)
    return np.asarray(last + 0.5 + np.clip(between, 0, 1), np.float64)


def _deviation(crowns: Array, rise: float, width: float, pixel: float) -> float:
    """Return the least mean deviation of the crowns that columns have from one crown near its expected height."""
    expected = crown_above(width, rise)
    tried = expected + pixel * np.arange(-_LOWEST, _LOWEST + 0.1, 0.25)
    off = np.abs(crowns[None] - tried[:, None])
    return float(np.minimum(off, _CLIP * pixel).mean(1).min())


class Proposals(NamedTuple):
    """Openings as the mesh has them.

    Attributes:
        boxes: left, top, right, bottom in coordinates of their walls, y up, with level heads, [n, 4].
        rises: of the arched heads that their contours have; 0 without, [n].
        level: whether a level head is possible, bool [n].
        walls: number of the wall that each is in, [n].
    """

    boxes: Array
    rises: Array
    level: NDArray[np.bool_]
    walls: Sequence[int]


class Heads(NamedTuple):
    """Heads of openings.

    Attributes:
        tops: of the crown or the lintel, [n].
        rises: 0 for a level one, [n].
        found: False where an opening has neither an arched head nor a level one, bool [n].
    """

    tops: Array
    rises: Array
    found: NDArray[np.bool_]


def heads_of_contours(proposed: Proposals) -> Heads:
    """Return the heads that the mesh has: arched ones where none is level."""
    rises = np.where(proposed.level, 0.0, proposed.rises)
    widths = proposed.boxes[:, 2] - proposed.boxes[:, 0]
    above = np.array([crown_above(width, rise) for width, rise in zip(widths, rises, strict=True)])
    return Heads(proposed.boxes[:, 1] + above, rises, proposed.level | (rises > 0))


def find_heads(
    proposed: Proposals,
    moved: Array,
    frames: Mapping[int, WallFrame],
    pixel: float,
    photos: EdgePhotos,
    options: ArchOptions = ArchOptions(),
    edges: OpeningEdgeOptions = OpeningEdgeOptions(),
) -> Heads:
    """Decide by the photos which openings have arched heads; those of one width in one row have the same.

    Args:
        proposed: the openings as the mesh has them.
        moved: left, top, right, bottom with the edges that the photos have, level heads, [n, 4].
        frames: number of a wall -> its coordinates.
        pixel: a ground pixel in these coordinates.
        photos: to look at.
        options: limits.
        edges: what photos show of an edge.
    """
    before, proposal = proposed.boxes[:, 1], proposed.rises
    tops, rises, found = heads_of_contours(proposed)
    tops = np.where(proposed.level, moved[:, 1], tops)
    rows = [row for row in _rows(proposed, moved, options.alike) if 2 * (proposal[row] > 0).sum() >= len(row)]
    offsets = np.arange(-edges.reach, edges.reach + 0.5 * STEP, STEP)
    some = [[row[k] for k in np.linspace(0, len(row) - 1, min(len(row), _MEMBERS)).astype(int)] for row in rows]
    members = [k for row in some for k in row]
    curves = [
        [_strip(before[k], moved[k], share, frames[proposed.walls[k]], pixel * offsets) for share in _RISES]
        for k in members
    ]
    gradients = dict(zip(members, compare_gradients(curves, photos, edges), strict=True))
    for row, looked_at in zip(rows, some, strict=True):
        known = np.array([gradients[k] for k in looked_at if np.isfinite(gradients[k]).all()])
        if not len(known):
            continue
        share, out = _best(known.mean(0), offsets, options, edges)
        for k in row:
            width = float(moved[k, 2] - moved[k, 0])
            arched = share * width >= options.rise * pixel
            rises[k] = share * width if arched else 0.0
            tops[k] = before[k] + crown_above(width, rises[k]) + out * pixel if arched else moved[k, 1]
            found[k] = arched or proposed.level[k]
    return Heads(tops, rises, found)


def _rows(proposed: Proposals, moved: Array, alike: float) -> list[list[int]]:
    """Return the openings of each wall whose upper edges are on one line and whose widths are alike."""
    lines: dict[tuple[int, float], list[int]] = {}
    for k, wall in enumerate(proposed.walls):
        lines.setdefault((wall, float(proposed.boxes[k, 1])), []).append(k)
    result = []
    for line in lines.values():
        widths = moved[line, 2] - moved[line, 0]
        order = np.argsort(widths)
        breaks = np.flatnonzero(widths[order][1:] > alike * widths[order][:-1]) + 1
        result += [[line[k] for k in group] for group in np.split(order, breaks)]
    return result


def _strip(top: float, box: Array, share: float, frame: WallFrame, offsets: Array) -> EdgeStrip:
    """Return the strip across a head whose level height is ``top``, of a rise over the width of a box [4]."""
    width, middle = float(box[2] - box[0]), 0.5 * float(box[0] + box[2])
    step = 2 * ALONG / STEP * float(offsets[1] - offsets[0])
    away = np.linspace(-0.5 * _INNER * width, 0.5 * _INNER * width, max(2, round(_INNER * width / step)))
    normal = np.tile([0.0, 1.0], (len(away), 1))
    if share > 0:
        across = away / arch_radius(width, share * width)
        normal = np.column_stack([across, np.sqrt(1 - across**2)])
    crown = top + crown_above(width, share * width)
    curve = np.column_stack([middle + away, crown - arch_drop(away, width, share * width)])
    at = curve[:, None] + offsets[None, :, None] * normal[:, None]
    points = frame.points(at.reshape(-1, 2)).reshape(*at.shape[:2], 3)
    return EdgeStrip(frame, points, np.array([0.0, 1.0]))


def _best(gradient: Array, offsets: Array, options: ArchOptions, edges: OpeningEdgeOptions) -> tuple[float, float]:
    """Choose the head across which the gradient [rises, offsets] is largest.

    Returns:
        Its rise over the width, 0 if a level head is as good, and the offset of its edge in ground pixels.
    """
    near = np.abs(offsets) <= edges.farthest[1]
    height = gradient[:, near].max(1)
    best = 1 + int(height[1:].argmax())
    if height[best] < options.gain * height[0]:
        return 0.0, 0.0
    out = wall_side_edge(gradient[best], offsets, edges, above=True)
    if best == len(_RISES) - 1:
        return SEMICIRCLE, out
    a, b, c = (float(height[best + step]) for step in (-1, 0, 1))
    shift = 0.5 * (a - c) / (a - 2 * b + c) if a - 2 * b + c < 0 else 0.0
    return float(np.interp(best + shift, np.arange(len(_RISES)), _RISES)), out
