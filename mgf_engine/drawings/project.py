# SPDX-License-Identifier: GPL-3.0-or-later
"""Orthographic z-buffer: the mesh as seen by parallel rays through a grid of pixels on a drawing's plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mgf_engine.drawings.model import Array, DrawingFrame, Survey
from mgf_engine.errors import BadInput
from mgf_engine.geometry.rasterize import render_parallel

Value = TypeVar("Value", bound=np.generic)
MOST_PIXELS = 400_000_000
MARGIN = 2  # pixels around what is drawn
STEPS = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0)  # times powers of ten: resolutions that people ask for


@dataclass(frozen=True)
class Grid:
    """Pixels over a frame: square, the first row at the top, edges at multiples of the resolution.

    Attributes:
        frame: what it lies on.
        resolution: side of a pixel in the local unit.
        left, top: drawing coordinates of the top-left corner.
        width, height: pixels.
    """

    frame: DrawingFrame
    resolution: float
    left: float
    top: float
    width: int
    height: int

    def pixels(self, at: Array) -> Array:
        """Convert drawing coordinates [..., 2 or 3] to columns and rows [..., 2]; the top-left centre is (0.5, 0.5)."""
        return np.stack([(at[..., 0] - self.left) / self.resolution, (self.top - at[..., 1]) / self.resolution], -1)

    def look_up(self, values: NDArray[Value], at: Array, outside: int) -> NDArray[Value]:
        """Look up the values of the pixels that places lie in.

        Args:
            values: of the pixels, [H, W].
            at: drawing coordinates, [n, 2 or 3].
            outside: value beside the grid.

        Returns:
            [n].
        """
        column, row = np.floor(self.pixels(at)).astype(np.int64).T
        inside = (row >= 0) & (row < self.height) & (column >= 0) & (column < self.width)
        found = np.full(len(at), outside, values.dtype)
        found[inside] = values[row[inside], column[inside]]
        return found

    def places(self, pixels: Array) -> Array:
        """Convert columns and rows [..., 2] to drawing coordinates [..., 2]."""
        return np.stack([self.left + pixels[..., 0] * self.resolution, self.top - pixels[..., 1] * self.resolution], -1)


@dataclass(frozen=True)
class GridBuffers:
    """What the pixels of a grid see.

    Attributes:
        face: int32 [H, W], row of the mesh's face, -1 where there is none or only its back.
        before: float32 [H, W], distance of the surface before the plane; NaN where there is none.
    """

    grid: Grid
    face: NDArray[np.int32]
    before: NDArray[np.float32]

    def points(self, index: NDArray[np.integer]) -> Array:
        """Return the points [n, 3], local frame, that pixels (flat indices [n]) see."""
        row, column = np.divmod(index, self.grid.width)
        at = self.grid.places(np.stack([column, row], 1) + 0.5)
        return self.grid.frame.to_local(np.column_stack([at, self.before.ravel()[index]]))


def plan_grid(frame: DrawingFrame, resolution: float) -> Grid:
    """Return the grid over all of a frame.

    Raises:
        BadInput: it would have more than :data:`MOST_PIXELS`.
    """
    low, high = np.floor(frame.low / resolution).astype(np.int64), np.ceil(frame.high / resolution).astype(np.int64)
    width, height = (high - low + 2 * MARGIN).tolist()
    if width * height > MOST_PIXELS:
        fits = round_resolution(resolution * float(np.sqrt(width * height / MOST_PIXELS)) * 1.5)
        raise BadInput(
            f"A drawing of '{frame.name}' at {1000 * resolution:g} mm per pixel has {width} x {height} pixels; "
            f"give --resolution {1000 * fits:g} or more."
        )
    return Grid(
        frame, resolution, (low[0] - MARGIN) * resolution, (high[1] + MARGIN) * resolution, int(width), int(height)
    )


def round_resolution(value: float) -> float:
    """Return the next finer resolution that people ask for: 1, 1.5, 2, 3, 4, 5, 6 or 8 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in STEPS if step * power <= value * (1 + 1e-9)) * power)


def render_grid(survey: Survey, grid: Grid) -> GridBuffers:
    """Render the survey's mesh at the grid's pixels along the normal, from outside."""
    at = grid.frame.to_drawing(survey.mesh.vertices)
    buffers = render_parallel(np.column_stack([grid.pixels(at), at[:, 2]]), survey.mesh.faces, grid.height, grid.width)
    behind = (survey.normals @ grid.frame.normal <= 0)[buffers.face]
    face = np.where(behind, np.int32(-1), buffers.face)
    return GridBuffers(grid, face, np.where(face >= 0, buffers.depth, np.float32(np.nan)))
