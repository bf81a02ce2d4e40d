# SPDX-License-Identifier: GPL-3.0-or-later
"""What several charts are made of: axes of time, names beside points, the frame."""

from __future__ import annotations

import textwrap
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Annotation
from matplotlib.ticker import LogFormatter, ScalarFormatter
from matplotlib.transforms import Bbox

#: Where a name may stand beside its point (points right and up); the first that is free is taken.
_SIDES = [(x, y) for y in (4, -11, 14, -21, 24, -31) for x in (5, -5)]
WORK = ("cpu_seconds", "CPU seconds, all cores together")


def time_axis(axes: Axes, label: str) -> None:
    """Make the horizontal axis logarithmic, with plain numbers."""
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(ScalarFormatter())
    axes.xaxis.set_minor_formatter(LogFormatter(minor_thresholds=(2, 0.5)))
    axes.set_xlabel(label)


def name_in(group: str, variant: str) -> str:
    """Return a variant's name less what the legend says of its group: 80k of "80k Gaussians", (a) of an ablation."""
    if group.startswith("ablation") and variant.startswith("("):
        return variant.partition(" ")[0]
    told = {group.rstrip("s"), "preset"}
    return " ".join(word for word in variant.split() if word.rstrip("s") not in told) or variant


def write_names(axes: Axes, names: list[tuple[str, tuple[float, float], Any]]) -> None:
    """Write each name beside its point, where it covers no other name and no point, if there is such a place."""
    figure = axes.get_figure()
    assert isinstance(figure, Figure)
    figure.draw_without_rendering()  # settles the scales
    dots = axes.transData.transform([place for _, place, _ in names])
    taken = [Bbox.from_bounds(x - 4, y - 4, 8, 8) for x, y in dots]
    legend = axes.get_legend()
    if legend is not None:
        taken.append(legend.get_window_extent())
    for own, (name, place, color) in enumerate(names):
        label = axes.annotate(name, place, (0, 0), textcoords="offset points", fontsize=7, color=color)
        others = [box for index, box in enumerate(taken) if index != own]

        def free(side: tuple[float, float], label: Annotation = label, others: list[Bbox] = others) -> bool:
            label.set_position(side)
            label.set_horizontalalignment("left" if side[0] > 0 else "right")
            return label.get_window_extent().count_overlaps(others) == 0

        if not any(free(side) for side in _SIDES):
            free(_SIDES[0])
        taken.append(label.get_window_extent())


def tidy(axes: Axes, legend: bool) -> None:
    """Draw a light grid and no box; with a legend, its long lines wrapped."""
    axes.grid(True, alpha=0.3)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    if legend:
        for line in axes.get_lines():
            line.set_label(textwrap.fill(str(line.get_label()), 44))
        axes.legend(fontsize=8, frameon=False)
