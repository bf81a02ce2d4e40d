# SPDX-License-Identifier: GPL-3.0-or-later
"""Speed against accuracy on all scenes of a suite in one picture: F1 against CPU seconds, one column per scene."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from statistics import mean
from typing import Any

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from benchmarks.chart_parts import WORK, name_in, tidy, time_axis, write_names
from benchmarks.measure import THRESHOLDS, f1_at
from benchmarks.suites import SETTINGS_APART

Row = dict[str, Any]
#: One row of panels for each of these distances, metres.
SHOWN = THRESHOLDS[:2]
#: Beginning of a group's name -> how its points look; a group that none fits takes the next of :data:`_OTHERS`.
_LOOKS: dict[str, dict[str, Any]] = {
    "presets": {"color": "#1f5fa8", "marker": "o", "markersize": 7},
    "paper": {"color": "#d1550b", "marker": "*", "markersize": 14},
    "ablation": {"color": "#d1550b", "marker": "o", "markersize": 6, "markerfacecolor": "white"},
    "OpenMVS": {"color": "#1a1a1a", "marker": "s", "markersize": 8},
}
_OTHERS = ("#54a24b", "#b279a2", "#8c6d31", "#72b7b2", "#e45756", "#9d9da1")
_LEGEND = {"presets": "our presets", "paper's setting": "the method as the paper prints it (preset paper)"}


def speed_figure(rows: Sequence[Row]) -> Figure:
    """Draw F1 against CPU seconds: a column of panels per scene, a row per distance, one legend for all.

    Args:
        rows: as :func:`benchmarks.measure.measure` makes them, with scores; several seeds of a variant are averaged.
    """
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    size = (1.2 + 3.9 * len(scenes), 1.3 + 3.1 * len(SHOWN))
    figure, grid = plt.subplots(
        len(SHOWN), len(scenes), figsize=size, layout="constrained", squeeze=False, sharex=True
    )  # fmt: skip
    looks = _looks(dict.fromkeys(_group(row) for row in rows))
    names = []
    for column, scene in zip(grid.T, scenes, strict=True):
        mine = [row for row in rows if row["scene"] == scene]
        column[0].set_title(_title(mine[0]), fontsize=10)
        names += [(axes, _panel(axes, mine, threshold, looks)) for axes, threshold in zip(column, SHOWN, strict=True)]
        column[-1].set_xlabel(WORK[1])
    for axes, threshold in zip(grid[:, 0], SHOWN, strict=True):
        axes.set_ylabel(f"F1 at {threshold * 100:.3g} cm, %")
    figure.suptitle("Speed against accuracy: further left is faster, further up more accurate", fontsize=11)
    known = {line.get_label(): line for axes in grid.flat for line in axes.get_lines()}
    figure.legend([known[key] for key in looks if key in known], [_told(key) for key in looks if key in known],
                  loc="outside lower center", ncols=2, fontsize=9, frameon=False)  # fmt: skip
    for axes, spots in names:
        write_names(axes, spots)
    return figure


def _group(row: Row) -> str:
    return row.get("group") or str(row["variant"])


def _looks(groups: Sequence[str] | dict[str, None]) -> dict[str, dict[str, Any]]:
    spare = iter(_OTHERS * len(groups))
    result = {}
    for group in groups:
        known = next((look for start, look in _LOOKS.items() if group.startswith(start)), None)
        result[group] = known or {"color": next(spare), "marker": "D", "markersize": 6}
    return result


def _told(group: str) -> str:
    """A group in the legend; the letters of an ablation stay together with what they mean."""
    text = _LEGEND.get(group, group.replace("ablation of it: ", "the same, one part changed: "))
    return textwrap.fill(text, 75)


def _title(row: Row) -> str:
    """The scene, how many photos of which size it has, and what a pixel covers."""
    name = Path(row["scene"]).name
    known = [f"{row['photos']} photos of {row['width']} px"] if "photos" in row else []
    known += [f"a pixel covers {row['ground_pixel'] * 100:.1f} cm"] if "ground_pixel" in row else []
    return f"{name}\n{', '.join(known)}"


def _panel(axes: Axes, rows: list[Row], threshold: float, looks: dict[str, dict[str, Any]]) -> list[Any]:
    """Draw the points of one scene at one distance; returns what :func:`write_names` writes beside them."""
    boxed = any(row.get("whole_picture") for row in rows) and all("in_box" in row for row in rows)
    scored, names = "in_box" if boxed else "geometry", list[Any]()
    for group in dict.fromkeys(_group(row) for row in rows):
        mine = [row for row in rows if _group(row) == group]
        spots = sorted(
            (mean(r["cpu_seconds"] for r in same), mean(f1_at(r, threshold, scored) for r in same), variant)
            for variant in dict.fromkeys(r["variant"] for r in mine)
            if (same := [r for r in mine if r["variant"] == variant])
        )
        line = "" if len(spots) == 1 or group.startswith(SETTINGS_APART) else "-"
        axes.plot([s[0] for s in spots], [s[1] for s in spots], linestyle=line, label=group, **looks[group])
        names += [(name_in(group, name), (work, value), looks[group]["color"]) for work, value, name in spots]
    axes.margins(x=0.22)  # for the names
    axes.set_ylim(0, min(105, 1.15 * max(value for _, (_, value), _ in names)))
    time_axis(axes, "")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_minor_formatter(NullFormatter())
    tidy(axes, legend=False)
    return names
