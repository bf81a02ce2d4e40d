# SPDX-License-Identifier: GPL-3.0-or-later
"""Scale bars: known distances between two points that are marked in two photos or more each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mgf_engine.errors import BadInput
from mgf_engine.georef.control_points import CHECK, CHECK_WORDS, CONTROL
from mgf_engine.georef.options import ScaleBarOptions
from mgf_engine.georef.tables import number_in, read_table
from mgf_engine.georef.triangulate import TriangulatedPoint

_COLUMNS = {
    "first": ("from", "first", "a", "start", "point1", "pointa"),
    "second": ("to", "second", "b", "end", "point2", "pointb"),
    "length": ("length", "distance", "metres", "meters", "m", "d"),
    "accuracy": ("accuracy", "sd", "sigma"),
    "role": ("role", "type", "use"),
}


@dataclass(frozen=True)
class ScaleBar:
    """A known distance in metres between two marked points."""

    first: str
    second: str
    length: float
    sd: float = ScaleBarOptions.accuracy
    role: str = CONTROL

    @property
    def name(self) -> str:
        """As tables show it."""
        return f"{self.first}–{self.second}"


@dataclass(frozen=True)
class MeasuredBar:
    """A scale bar and what the scene makes of it: ``found`` metres; ``used`` for the scale."""

    bar: ScaleBar
    found: float
    used: bool

    @property
    def error(self) -> float:
        """Metres, found less given."""
        return self.found - self.bar.length


def read_bars(path: Path, options: ScaleBarOptions = ScaleBarOptions()) -> tuple[ScaleBar, ...]:
    """Read the distances of a file: from, to, length in metres, and where given accuracy and role.

    Raises:
        BadInput: the file cannot be used.
    """
    table = read_table(path, _COLUMNS)
    at = table.columns or dict(zip(_COLUMNS, range(5), strict=True))
    missing = [name for name in ("first", "second", "length") if name not in at]
    if missing:
        heading = {"first": "from", "second": "to"}.get(missing[0], missing[0])
        raise BadInput(f"'{path}' has no column '{heading}'; name the columns from, to, length.")
    bars = []
    for row in range(len(table.rows)):
        length = table.number(row, at["length"])
        if length <= 0:
            raise BadInput(f"Line {table.lines[row]} of '{path}' has a length of {length:g}; give metres above zero.")
        sd = number_in(table.text(row, at.get("accuracy"))) or options.accuracy
        role = CHECK if table.text(row, at.get("role")).lower() in CHECK_WORDS else CONTROL
        bars.append(ScaleBar(table.text(row, at["first"]), table.text(row, at["second"]), length, abs(sd), role))
    return tuple(bars)


def measure_bars(
    bars: Sequence[ScaleBar],
    placed: Mapping[str, TriangulatedPoint],
    scale: float | None,
    options: ScaleBarOptions = ScaleBarOptions(),
) -> tuple[float, list[MeasuredBar]]:
    """Find the scale in metres per unit of the normalised frame, and measure each bar with it.

    Args:
        bars: known distances.
        placed: marked points in the normalised frame, by name.
        scale: where control points give it; None takes it from the bars, the outliers among them left out.
        options: limit of outliers.

    Raises:
        BadInput: none of them can be measured.
    """
    known = [bar for bar in bars if bar.first in placed and bar.second in placed]
    spans = np.array([np.linalg.norm(placed[b.first].position - placed[b.second].position) for b in known])
    if not known or (spans <= 0).any():
        first = next((b for b in bars if b not in known), bars[0])
        raise BadInput(
            f"The scale bar {first.name} cannot be measured: mark both of its ends in two photos or more (--marks)."
        )
    used = np.array([bar.role == CONTROL for bar in known])
    if scale is None:
        used = used if used.any() else np.ones(len(known), bool)
        scale, used = _scale(known, spans, used, options.outlier)
    else:
        used = np.zeros(len(known), bool)
    rows = [MeasuredBar(b, float(s * scale), bool(u)) for b, s, u in zip(known, spans, used, strict=True)]
    return scale, rows


def _scale(bars: Sequence[ScaleBar], spans: np.ndarray, used: np.ndarray, outlier: float) -> tuple[float, np.ndarray]:
    """Return the weighted mean of the ratios, without those far from their median (where there are three or more)."""
    ratios = np.array([bar.length for bar in bars]) / spans
    if used.sum() >= 3:
        middle = float(np.median(ratios[used]))
        away = np.abs(ratios / middle - 1)
        usual = max(float(np.median(away[used])), 0.002)
        used = used & (away <= outlier * usual)
    weights = np.array([(bar.length / bar.sd) ** 2 for bar in bars]) * used
    return float(np.average(ratios, weights=weights)), used
