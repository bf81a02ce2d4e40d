# SPDX-License-Identifier: GPL-3.0-or-later
"""Sheets for printing: orthophotos and lines at a round scale on A3 or A1, with scale bar, legend and title."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from shapely import Polygon

from mgf_engine.drawings.model import (
    CREASE,
    CUT,
    DETAIL,
    OUTLINE,
    PART,
    STEP,
    DrawingFrame,
    LineDrawing,
    Survey,
    pen_width,
    rings_of,
)
from mgf_engine.drawings.project import Grid
from mgf_engine.drawings.vector_files import layer_name
from mgf_engine.errors import BadInput
from mgf_engine.files.atomic import atomic_path

PAPERS = {"A3": (420.0, 297.0), "A1": (841.0, 594.0)}  # millimetres
SCALES = (5, 10, 20, 25, 50, 100, 200, 250, 500, 1000, 2000, 5000)
BARS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0)  # lengths of scale bars
MARGIN, FOOT = 12.0, 30.0  # millimetres: around, and below for scale bar and title
INCH = 25.4
POINTS = 72 / INCH
_MEANING = {
    OUTLINE: "outline", CUT: "cut", STEP: "step in depth", CREASE: "two planes meet",
    DETAIL: "detail in no plane",
}  # fmt: skip


def choose_scale(size: NDArray[np.float64], paper: str, wanted: float | None = None) -> float:
    """Choose the largest round scale at which a drawing of this width and height fits, or the wanted one.

    Raises:
        BadInput: none does, or the wanted one does not.
    """
    least, fitting = _least_scale(size, paper), fitting_scale(size, paper)
    if fitting < least:
        raise BadInput(
            f"A drawing of {size[0]:.0f} x {size[1]:.0f} fits on no sheet {paper}; give the scene true lengths."
        )
    if wanted is not None and wanted < least:
        raise BadInput(
            f"A drawing of {size[0]:.1f} x {size[1]:.1f} does not fit on {paper} at 1:{wanted:g}; "
            f"give --scale {fitting} or a larger sheet."
        )
    return fitting if wanted is None else wanted


def fitting_scale(size: NDArray[np.float64], paper: str) -> float:
    """Return the largest round scale at which a drawing fits on paper; the smallest where none does."""
    least = _least_scale(size, paper)
    return next((scale for scale in SCALES if scale >= least), SCALES[-1])


def _least_scale(size: NDArray[np.float64], paper: str) -> float:
    """Return the N of 1:N at which a drawing of this width and height fills the sheet."""
    room = np.array(PAPERS[paper]) - 2 * MARGIN - (0, FOOT)
    return float((1000 * size / room).max())


def north_in(survey: Survey, frame: DrawingFrame) -> NDArray[np.float64] | None:
    """Return the direction of north in a drawing from above, unit [2]; None in others, and if it is unknown."""
    if not frame.from_above or not survey.georeference.north_known:
        return None
    return np.array([frame.x[1], frame.y[1]])


@dataclass(frozen=True)
class Sheet:
    """What a sheet says beside its drawing.

    Attributes:
        paper: its size, such as A3.
        scale: N of 1:N.
        title: of the drawing.
        project: what the drawing is of.
        facts: coordinate reference system, size of a pixel.
        levels: heights to be marked, and what stands beside them.
        north: direction in the drawing, [2], or None.
    """

    paper: str
    scale: float
    title: str
    project: str
    facts: str = ""
    levels: Sequence[tuple[float, str]] = ()
    north: NDArray[np.float64] | None = None


def write_sheet(path: Path, sheet: Sheet, drawing: LineDrawing, photo: tuple[NDArray[np.uint8], Grid] | None) -> None:
    """Write a PDF or SVG, by the path's ending, at the sheet's scale (see :func:`choose_scale`).

    Args:
        path: of the sheet.
        sheet: its size, scale and texts.
        drawing: its lines.
        photo: what lies under the lines, RGBA, and where; None for lines alone.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    wide, high = PAPERS[sheet.paper]
    figure = Figure(figsize=(wide / INCH, high / INCH))
    FigureCanvasAgg(figure)
    size = 1000 * drawing.frame.size / sheet.scale
    left, bottom = (wide - size[0]) / 2, FOOT + (high - FOOT - size[1]) / 2
    axes = figure.add_axes((left / wide, bottom / high, size[0] / wide, size[1] / high))
    axes.set_axis_off()
    low, top = drawing.frame.low, drawing.frame.high
    if photo is not None:
        image, grid = photo
        right, under = grid.left + grid.width * grid.resolution, grid.top - grid.height * grid.resolution
        axes.imshow(image, extent=(grid.left, right, under, grid.top), aspect="auto", interpolation="none")
    axes.set_xlim(low[0], top[0])
    axes.set_ylim(low[1], top[1])
    for area in drawing.areas:
        axes.add_patch(_hatched(area))
    for line in drawing.lines:
        width = pen_width(line.layer) * POINTS
        axes.plot(*line.points.T, color="black", linewidth=width, solid_capstyle="round", clip_on=False)
    _mark_levels(axes, sheet, low, top)
    _foot(figure, drawing, sheet, photo is not None)
    how: dict[str, Any] = {"Date": None} if path.suffix == ".svg" else {"CreationDate": None}
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format=path.suffix[1:], metadata={**how, "Title": f"{sheet.project}: {sheet.title}"})


def _hatched(area: Polygon) -> Any:
    """Make the hatched patch of a cut area without its holes."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    rings = [Outline(ring, closed=True) for ring in rings_of(area)]
    return PathPatch(
        Outline.make_compound_path(*rings), facecolor="none", edgecolor="0.4", hatch="//", linewidth=0, clip_on=False
    )


def _mark_levels(axes: Any, sheet: Sheet, low: NDArray[np.float64], top: NDArray[np.float64]) -> None:
    """Mark heights with a triangle and a number left of the drawing, and the lowest, the ground, with a heavy line."""
    millimetre = sheet.scale / 1000
    above = None
    for k, (height, text) in enumerate(sorted(sheet.levels)):
        if k == 0:
            ends = [low[0] - 6 * millimetre, top[0] + 6 * millimetre]
            axes.plot(ends, [height, height], color="black", linewidth=0.7 * POINTS, clip_on=False)
        elif above is not None and height - above < 3.5 * millimetre:
            continue  # its number would lie on the one below
        above = height
        tip = np.array([low[0] - 4 * millimetre, height])
        corners = tip + np.array([(0, 0), (-0.9, 1.5), (0.9, 1.5)]) * millimetre
        axes.fill(*corners.T, color="black", linewidth=0, clip_on=False)
        axes.plot([tip[0] - millimetre, low[0] - millimetre], [height] * 2, color="black", linewidth=0.4, clip_on=False)
        axes.text(tip[0] - 1.4 * millimetre, height + 0.3 * millimetre, text, fontsize=6.5, ha="right", clip_on=False)


def _foot(figure: Any, drawing: LineDrawing, sheet: Sheet, photo: bool) -> None:
    """Draw scale bar, legend, north and title along the lower edge."""
    wide, high = PAPERS[sheet.paper]
    axes = figure.add_axes((0, 0, 1, FOOT / high))
    axes.set_axis_off()
    axes.set_xlim(0, wide)
    axes.set_ylim(0, FOOT)
    axes.plot([MARGIN, wide - MARGIN], [FOOT - 2, FOOT - 2], color="black", linewidth=0.8)
    length = max((step for step in BARS if 1000 * step / sheet.scale <= 80), default=BARS[0])
    millimetres = 1000 * length / sheet.scale
    for k in range(4):
        color = "black" if k % 2 == 0 else "white"
        box = [MARGIN + k * millimetres / 4, MARGIN + (k + 1) * millimetres / 4]
        axes.fill_between(box, 8, 10, facecolor=color, edgecolor="black", linewidth=0.5)
    unit = "" if sheet.facts.startswith("lengths") else " m"
    for share, text in ((0.0, "0"), (0.5, f"{length / 2:g}"), (1.0, f"{length:g}{unit}")):
        axes.text(MARGIN + share * millimetres, 12, text, fontsize=7, ha="center")
    axes.text(MARGIN, 18, f"1:{sheet.scale:g}", fontsize=11, weight="bold")
    _legend(axes, drawing, photo)
    if sheet.north is not None:
        _north_arrow(axes, np.array([wide - MARGIN - 150, 14.0]), sheet.north)
    axes.text(wide - MARGIN, 20, sheet.title, fontsize=14, ha="right", weight="bold")
    axes.text(wide - MARGIN, 14, sheet.project, fontsize=9, ha="right")
    axes.text(wide - MARGIN, 8, "   ".join(t for t in (sheet.facts, sheet.paper, "MGF") if t), fontsize=8, ha="right")


def _legend(axes: Any, drawing: LineDrawing, photo: bool) -> None:
    """Draw what the lines mean, three in a column; of a photo, what is blank."""
    if photo:
        axes.text(MARGIN + 100, 8, "blank: shown by no photo", fontsize=7)
    layers = [layer for layer in dict.fromkeys(line.layer for line in drawing.lines) if not layer.startswith(PART)]
    parts = list(dict.fromkeys(line.layer for line in drawing.lines if line.layer.startswith(PART)))
    for k, layer in enumerate([*layers, *parts]):
        x, y = MARGIN + 100 + 48 * (k // 3), 19 - 5.5 * (k % 3)
        axes.plot([x, x + 10], [y, y], color="black", linewidth=pen_width(layer) * POINTS)
        axes.text(x + 12, y, _MEANING.get(layer, layer_name(layer)), fontsize=7, va="center")


def _north_arrow(axes: Any, at: NDArray[np.float64], north: NDArray[np.float64]) -> None:
    """Draw an arrow to the north, 12 mm long, around a place of the foot."""
    side = np.array([north[1], -north[0]])
    axes.fill(*np.stack([at + 6 * north, at - 5 * north + 3 * side, at - 3 * north]).T, color="black", linewidth=0)
    left = np.stack([at + 6 * north, at - 5 * north - 3 * side, at - 3 * north, at + 6 * north])
    axes.plot(*left.T, color="black", linewidth=0.6)
    axes.text(*(at + 8.5 * north), "N", fontsize=8, ha="center", va="center")
