# SPDX-License-Identifier: GPL-3.0-or-later
"""Sheets for printing: orthophotos and lines at a round scale on A3 or A1, with scale bar, legend and title."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgf_engine.drawings.model import LineDrawing, pen_width
from mgf_engine.drawings.project import Grid
from mgf_engine.errors import BadInput
from mgf_engine.system import atomic_path

PAPERS = {"A3": (420.0, 297.0), "A1": (841.0, 594.0)}  # millimetres
SCALES = (5, 10, 20, 25, 50, 100, 200, 250, 500, 1000, 2000, 5000)
BARS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0)  # lengths of scale bars
MARGIN, FOOT = 12.0, 30.0  # millimetres: around, and below for scale bar and title
INCH = 25.4
POINTS = 72 / INCH


def choose_scale(size: NDArray[np.float64], paper: str, wanted: float | None = None) -> float:
    """Choose the largest round scale at which a drawing of this width and height fits, or the wanted one.

    Raises:
        BadInput: none does, or the wanted one does not.
    """
    wide, high = PAPERS[paper]
    room = np.array([wide - 2 * MARGIN, high - 2 * MARGIN - FOOT])
    least = float((1000 * size / room).max())
    fitting = next((scale for scale in SCALES if scale >= least), None)
    if fitting is None:
        raise BadInput(
            f"A drawing of {size[0]:.0f} x {size[1]:.0f} fits on no sheet {paper}; give the scene true lengths."
        )
    if wanted is not None and wanted < least:
        raise BadInput(
            f"A drawing of {size[0]:.1f} x {size[1]:.1f} does not fit on {paper} at 1:{wanted:g}; "
            f"give --scale {fitting} or a larger sheet."
        )
    return fitting if wanted is None else wanted


def write_sheet(
    path: Path,
    drawing: LineDrawing,
    image: NDArray[np.uint8] | None,
    grid: Grid | None,
    title: str,
    paper: str,
    scale: float,
) -> None:
    """Write a PDF or SVG, by the path's ending, at 1:scale (see :func:`choose_scale`).

    Args:
        path: of the sheet.
        drawing: its lines.
        image, grid: what lies under the lines, and where; None for lines alone.
        title: below the drawing.
        paper: size of the sheet, such as A3.
        scale: denominator of the scale.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    wide, high = PAPERS[paper]
    figure = Figure(figsize=(wide / INCH, high / INCH))
    FigureCanvasAgg(figure)
    size = 1000 * drawing.frame.size / scale
    left, bottom = (wide - size[0]) / 2, FOOT + (high - FOOT - size[1]) / 2
    axes = figure.add_axes((left / wide, bottom / high, size[0] / wide, size[1] / high))
    axes.set_axis_off()
    low, top = drawing.frame.low, drawing.frame.high
    axes.set_xlim(low[0], top[0])
    axes.set_ylim(low[1], top[1])
    if image is not None and grid is not None:
        right, under = grid.left + grid.width * grid.resolution, grid.top - grid.height * grid.resolution
        axes.imshow(image, extent=(grid.left, right, under, grid.top), aspect="auto", interpolation="none")
        axes.set_xlim(low[0], top[0])
        axes.set_ylim(low[1], top[1])
    for area in drawing.areas:
        axes.fill(*area.outer.T, facecolor="none", edgecolor="0.4", hatch="//", linewidth=0)
    for line in drawing.lines:
        width = pen_width(line.layer) * POINTS
        axes.plot(*line.points.T, color="black", linewidth=width, solid_capstyle="round", clip_on=False)
    _foot(figure, drawing, title, scale, paper)
    how: dict[str, Any] = {"Date": None} if path.suffix == ".svg" else {"CreationDate": None}
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format=path.suffix[1:], metadata=how)


def _foot(figure: Any, drawing: LineDrawing, title: str, scale: float, paper: str) -> None:
    """Draw scale bar, legend and title along the lower edge."""
    wide, high = PAPERS[paper]
    axes = figure.add_axes((0, 0, 1, FOOT / high))
    axes.set_axis_off()
    axes.set_xlim(0, wide)
    axes.set_ylim(0, FOOT)
    axes.plot([MARGIN, wide - MARGIN], [FOOT - 2, FOOT - 2], color="black", linewidth=0.8)
    length = max((step for step in BARS if 1000 * step / scale <= 80), default=BARS[0])
    millimetres = 1000 * length / scale
    for k in range(4):
        color = "black" if k % 2 == 0 else "white"
        box = [MARGIN + k * millimetres / 4, MARGIN + (k + 1) * millimetres / 4]
        axes.fill_between(box, 8, 10, facecolor=color, edgecolor="black", linewidth=0.5)
    axes.text(MARGIN, 12, "0", fontsize=7, ha="center")
    axes.text(MARGIN + millimetres, 12, f"{length:g} m", fontsize=7, ha="center")
    axes.text(wide - MARGIN, 16, title, fontsize=14, ha="right", weight="bold")
    axes.text(wide - MARGIN, 8, f"1:{scale:g}   {paper}   MGF", fontsize=9, ha="right")
    x = MARGIN + 100
    for layer in dict.fromkeys(line.layer for line in drawing.lines):
        axes.plot([x, x + 10], [9, 9], color="black", linewidth=pen_width(layer) * POINTS)
        axes.text(x, 11.5, layer.lower(), fontsize=6)
        x += 24
