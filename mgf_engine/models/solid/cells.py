# SPDX-License-Identifier: GPL-3.0-or-later
"""Cut the ground plan into convex cells along lines."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray

from mgf_engine.drawings.project import Grid
from mgf_engine.models.solid.model import Array
from mgf_engine.models.solid.plan_lines import Line2

STEP = 5000  # crossings of lines lie on a grid of the plan's size over this
OUTSIDE = -1


@dataclass
class Cells:
    """Convex cells that share their corners.

    Attributes:
        nodes: corners in the ground plan, [N, 2].
        rings: rows of ``nodes`` around each cell, counter-clockwise.
        sides: (first node, second node) of a ring -> its cell; what has no other side borders the outside.
        step: of the grid that the nodes lie on.
    """

    nodes: list[tuple[float, float]]
    rings: list[list[int]]
    sides: dict[tuple[int, int], int]
    step: float

    def borders(self) -> list[tuple[int, int, int, int]]:
        """List each edge once: its nodes, the cell to the left and the one to the right (:data:`OUTSIDE` for none)."""
        result = []
        for (u, v), cell in self.sides.items():
            other = self.sides.get((v, u), OUTSIDE)
            if other < cell:
                result.append((u, v, cell, other))
        return result

    def divide(self, u: int, v: int, at: tuple[float, float]) -> None:
        """Put a new corner on an edge."""
        new = len(self.nodes)
        self.nodes.append(at)
        for first, second in ((u, v), (v, u)):
            cell = self.sides.pop((first, second), None)
            if cell is not None:
                ring = self.rings[cell]
                ring.insert(ring.index(first) + 1, new)
                self.sides[first, new] = self.sides[new, second] = cell


def cut_into_cells(lines: list[Line2], low: Array, high: Array) -> Cells:
    """Cut a rectangle along lines that cross all of it."""
    reach = float(np.linalg.norm(high - low))
    step = float(10.0 ** np.floor(np.log10(reach / STEP)))
    middle = 0.5 * (low + high)
    drawn = [shapely.box(*low, *high).exterior]
    for line in lines:
        foot = middle + line.normal * (line.offset - float(line.normal @ middle))
        drawn.append(shapely.LineString([foot - reach * line.along, foot + reach * line.along]))
    box = shapely.box(*low, *high)
    network = shapely.union_all([shapely.intersection(each, box) for each in drawn], grid_size=step)
    polygons = [shapely.orient_polygons(p) for p in shapely.polygonize([network]).geoms]
    cells = Cells([], [], {}, step)
    known: dict[tuple[int, int], int] = {}
    for polygon in polygons:
        ring = []
        for x, y in shapely.get_coordinates(polygon.exterior)[:-1].tolist():
            key = (round(x / step), round(y / step))
            if key not in known:
                known[key] = len(cells.nodes)
                cells.nodes.append((x, y))
            ring.append(known[key])
        for u, v in zip(ring, ring[1:] + ring[:1], strict=True):
            cells.sides[u, v] = len(cells.rings)
        cells.rings.append(ring)
    return cells


def cell_of_pixels(cells: Cells, grid: Grid) -> NDArray[np.int32]:
    """Return the cell of each pixel, int32 [H, W]; :data:`OUTSIDE` beside all."""
    owner = np.full((grid.height, grid.width), OUTSIDE, np.int32)
    nodes = np.array(cells.nodes)
    for k, ring in enumerate(cells.rings):
        at = grid.pixels(nodes[ring]) - 0.5
        cv2.fillPoly(owner, [np.rint(at * 16).astype(np.int32)], k, shift=4)
    return owner
