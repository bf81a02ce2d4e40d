# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh an opening in a wall and the wall around it by a grid: surroundings, reveals and a flat bottom.

The rows of the grid are level; under an arched head they bend, so that one of them follows it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.rasterize import render_parallel
from mgf_engine.openings.arches import arch_drop, arch_places

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_PIXEL = 0.5  # of height maps, ground px
_RING, _BOTTOM = 1.0, 2.0  # largest steps of the grid beside an opening and over it, ground px


class HeightMap(NamedTuple):
    """How far a mesh lies before the plane of a wall.

    Attributes:
        height: at each pixel, ground pixels, NaN where there is no mesh, float32 [H, W].
        corner: x and y of its upper left corner, [2].
    """

    height: NDArray[np.float32]
    corner: Array

    def at(self, places: Array) -> Array:
        """Look up the height at places [n, 2] on the wall; NaN where there is no mesh, [n]."""
        column = np.clip((places[:, 0] - self.corner[0]) / _PIXEL, 0, self.height.shape[1] - 1).astype(int)
        row = np.clip((self.corner[1] - places[:, 1]) / _PIXEL, 0, self.height.shape[0] - 1).astype(int)
        return self.height[row, column].astype(np.float64)


def height_map(at: Array, faces: Index, box: Array, before: float) -> HeightMap:
    """Render a mesh from before a wall.

    Args:
        at: vertices in coordinates of the wall, ground pixels, [N, 3].
        faces: [F, 3].
        box: left, top, right, bottom of the map.
        before: what lies farther before the wall is left out.
    """
    shown = faces[(at[faces, 2] <= before).all(1)]
    used, corner = np.unique(shown, return_inverse=True)
    left, top, right, bottom = box
    pixels = np.column_stack([(at[used, 0] - left) / _PIXEL, (top - at[used, 1]) / _PIXEL, at[used, 2]])
    width, height = int(np.ceil((right - left) / _PIXEL)), int(np.ceil((top - bottom) / _PIXEL))
    seen = render_parallel(pixels, corner.reshape(-1, 3).astype(np.int32), height, width)
    return HeightMap(np.where(seen.face >= 0, seen.depth, np.float32(np.nan)), np.array([left, top]))


class OpeningGrid(NamedTuple):
    """The mesh of an opening and of what is around it, up to a step from the rectangle that it is to be joined at.

    Attributes:
        vertices: coordinates of the wall, [N, 3].
        faces: [F, 3].
        border: its outermost vertices, counter-clockwise from the lower left, [B].
        outer: left, top, right, bottom of the rectangle that it is to be joined at, [4].
    """

    vertices: Array
    faces: Index
    border: Index
    outer: Array

    def join(self, along: Array) -> Index:
        """Return faces between the grid's border and vertices along the rectangle.

        Args:
            along: where the vertices lie, as :func:`around_rectangle` gives, from 0 on, [S].

        Returns:
            [S + B, 3]; the vertex at ``along[k]`` has the number -1 - k.
        """
        rows = self.vertices[self.border, :2]
        low, high = rows.min(0), rows.max(0)
        own = around_rectangle(rows, np.array([low[0], high[1], high[0], low[1]]))
        places = np.concatenate([np.append(np.maximum.accumulate(along)[1:], 4.0), np.append(own[1:], 4.0)])
        outside = np.arange(len(places)) < len(along)
        order = np.argsort(places, kind="stable")
        step = outside[order]
        a: Index = np.cumsum(step) - step  # those that each step begins at
        b: Index = np.cumsum(~step) - ~step
        at_rectangle, at_border = -1 - a % len(along), self.border[b % len(own)]
        ahead = np.where(step, -1 - (a + 1) % len(along), self.border[(b + 1) % len(own)])
        return np.where(step[:, None], np.stack([at_rectangle, ahead, at_border], 1),
                        np.stack([ahead, at_border, at_rectangle], 1))  # fmt: skip


def around_rectangle(at: Array, box: Array) -> Array:
    """Return where points lie along a rectangle, 0..4 counter-clockwise from its lower left corner, a side each.

    Args:
        at: on the rectangle, [n, 2].
        box: its left, top, right, bottom.
    """
    left, top, right, bottom = box
    x, y = (at[:, 0] - left) / (right - left), (at[:, 1] - bottom) / (top - bottom)
    sides = [at[:, 1] == bottom, at[:, 0] == right, at[:, 1] == top]
    return np.asarray(np.select(sides, [x, 1 + y, 3 - x], 4 - y))


def opening_grid(box: Array, outer: Array, depth: float, heights: HeightMap, rise: float = 0.0) -> OpeningGrid:
    """Mesh an opening and what is around it: what the wall has before its plane stays, nothing is behind it.

    Args:
        box: left, top, right, bottom of the opening, y up.
        outer: those of a rectangle around it.
        depth: of the opening's bottom.
        heights: of the mesh within ``outer``.
        rise: of the opening's arched head; 0 for a level one.
    """
    x, columns = _steps(outer[0], box[0], box[2], outer[2])
    if rise:
        middle = 0.5 * (box[0] + box[2]) + arch_places(box[2] - box[0], rise, _BOTTOM)
        x = np.concatenate([x[: columns[0]], middle, x[columns[1] + 1 :]])
        columns = (columns[0], columns[0] + len(middle) - 1)
    y, rows = _steps(outer[3], box[3], box[1], outer[1])
    place = np.stack(np.meshgrid(x, y), -1)
    if rise:
        place[..., 1] = _below_arch(x, y, box, rise)
    number = np.arange(place[..., 0].size).reshape(len(y), len(x))
    over = (slice(rows[0], rows[1] + 1), slice(columns[0], columns[1] + 1))
    z = np.maximum(np.nan_to_num(heights.at(place.reshape(-1, 2)).reshape(place.shape[:-1])), 0.0)
    bottom = place[over].reshape(-1, 2)
    at = np.concatenate(
        [np.column_stack([place.reshape(-1, 2), z.ravel()]), np.column_stack([bottom, np.full(len(bottom), -depth)])]
    )
    below = number.size + np.arange(len(bottom)).reshape(number[over].shape)
    open_cell = np.zeros((len(y) - 1, len(x) - 1), bool)
    open_cell[rows[0] : rows[1], columns[0] : columns[1]] = True
    rim, rim_below = _border(number[over]), _border(below)
    reveals = np.stack([rim, np.roll(rim, -1), np.roll(rim_below, -1), rim_below], 1)
    quads = np.concatenate([_cells(number)[~open_cell.ravel()], _cells(below), reveals])
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    used, corner = np.unique(faces, return_inverse=True)  # not those over the opening
    return OpeningGrid(at[used], corner.reshape(-1, 3), np.searchsorted(used, _border(number)), outer)


def _steps(outer_low: float, low: float, high: float, outer_high: float) -> tuple[Array, tuple[int, int]]:
    """Return the places of a grid along one axis, and the numbers of those at which the opening begins and ends."""
    first = np.linspace(outer_low, low, max(2, round((low - outer_low) / _RING)) + 1)[1:]
    middle = np.linspace(low, high, max(2, round((high - low) / _BOTTOM)) + 1)
    last = np.linspace(high, outer_high, max(2, round((outer_high - high) / _RING)) + 1)[:-1]
    return np.concatenate([first[:-1], middle, last[1:]]), (len(first) - 1, len(first) + len(middle) - 2)


def _below_arch(x: Array, y: Array, box: Array, rise: float) -> Array:
    """Return the heights of a grid [H, W] whose row at the top of an opening follows its arched head; the grid's border
    and what is below the opening stay level.

    Args:
        x: places of its columns, [W].
        y: places of its rows, [H].
        box: left, top, right, bottom of the opening, [4].
        rise: of its head.
    """
    left, top, right, bottom = box
    drop = arch_drop(x - 0.5 * (left + right), right - left, rise)
    drop *= np.interp(x, [x[0], left, right, x[-1]], [0.0, 1.0, 1.0, 0.0])
    share = np.interp(y, [bottom, top, y[-1]], [0.0, 1.0, 0.0])
    return np.asarray(y[:, None] - share[:, None] * drop[None])


def _cells(number: Index) -> Index:
    """Return the quadrangles between vertices of a grid [H, W] whose rows go up, [cells, 4]."""
    corners = [number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]]
    return np.stack([corner.ravel() for corner in corners], 1)


def _border(number: Index) -> Index:
    """Return the border of a grid [H, W] whose rows go up, counter-clockwise from the lower left."""
    return np.concatenate([number[0, :-1], number[:-1, -1], number[-1, :0:-1], number[:0:-1, 0]])
