# SPDX-License-Identifier: GPL-3.0-or-later
"""The failure map as pictures: one small chart per perturbation, all on one sheet, and a page with a table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from benchmarks.page import write_html

#: Colour per mode; marker per outcome.
COLORS = {"masks": "#2a6fbb", "no masks": "#c8632a"}
MARKERS = {"silent": "o", "warned": "^", "refused": "X", "fault": "*"}
_COLUMNS = 4


def write_page(entries: Sequence[dict[str, Any]], out: Path) -> Path:
    """``stability.html`` and ``charts/stability-f1.png`` / ``-psnr.png`` in ``out``; returns the page."""
    charts = out / "charts"
    charts.mkdir(parents=True, exist_ok=True)
    draw_sheet(entries, "share", charts / "stability-f1.png")
    draw_sheet(entries, "psnr", charts / "stability-psnr.png")
    (out / "stability.md").write_text(markdown(entries), encoding="utf-8")
    return write_html("stability.html.j2", out / "stability.html", lines=table(entries), entries=entries)


def draw_sheet(entries: Sequence[dict[str, Any]], key: str, path: Path) -> None:
    """All curves of one quantity, ``share`` (F1 as a share of the undisturbed one) or ``psnr``."""
    rows = max(1, math.ceil(len(entries) / _COLUMNS))
    figure, grid = plt.subplots(
        rows, _COLUMNS, figsize=(3.2 * _COLUMNS, 2.5 * rows), layout="constrained", squeeze=False
    )
    for axes, entry in zip(grid.flat, entries, strict=False):
        _draw(axes, entry, key)
    for axes in list(grid.flat)[len(entries) :]:
        axes.set_visible(False)
    for mode in (m for m in COLORS if any(m in entry["curves"] for entry in entries)):
        grid.flat[0].plot([], [], color=COLORS[mode], label=mode)
    grid.flat[0].legend(fontsize=7, frameon=False, loc="lower left")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _draw(axes: Axes, entry: dict[str, Any], key: str) -> None:
    levels = list(entry["entry"].levels)
    for mode, curve in entry["curves"].items():
        points = [p for p in curve if p[key] is not None]
        places = [levels.index(p["level"]) for p in points]
        values = [100 * p[key] if key == "share" else p[key] for p in points]
        axes.plot(places, values, color=COLORS[mode], linewidth=1.3)
        for place, value, point in zip(places, values, points, strict=True):
            axes.plot(place, value, marker=MARKERS[point["outcome"]], color=COLORS[mode], markersize=6)
    axes.set_xticks(range(len(levels)), [f"{level:g}" for level in levels], fontsize=7)
    axes.set_title(f"{entry['entry'].title} ({entry['entry'].unit or 'count'})", fontsize=8)
    axes.tick_params(axis="y", labelsize=7)
    if key == "share":
        axes.set_ylim(-4, 112)
        for line in (90, 50):
            axes.axhline(line, color="#999999", linewidth=0.7, linestyle=":")
    axes.spines[["top", "right"]].set_visible(False)


def table(entries: Sequence[dict[str, Any]]) -> list[list[str]]:
    """Lines of text: perturbation, mode, F1 at every level, where 90 % and 50 % of it are lost, what is said."""
    lines = []
    for entry in entries:
        kind = entry["entry"]
        for mode, curve in entry["curves"].items():
            f1 = ", ".join(f"{p['level']:g}: {p['f1']:.1f}{_sign(p['outcome'])}" for p in curve)
            said = next((p["text"] for p in reversed(curve) if p["text"]), "")
            lines.append([
                f"{kind.title} ({kind.unit or 'count'})", mode, f1, _level(entry["kept"][mode]),
                _level(entry["useless"][mode]), _cut(said),
            ])  # fmt: skip
    return lines


def markdown(entries: Sequence[dict[str, Any]]) -> str:
    """The table for the documentation."""
    head = ["perturbation", "mode", "F1 per level", "under 90 % from", "useless from", "said at the worst level"]
    lines = [head, ["---"] * len(head), *table(entries)]
    return "\n".join("| " + " | ".join(cell.replace("|", "/") for cell in line) + " |" for line in lines) + "\n"


def _level(value: float | None) -> str:
    return "not reached" if value is None else f"{value:.3g}"


def _sign(outcome: str) -> str:
    return {"silent": "", "warned": " w", "refused": " r", "fault": " FAULT"}[outcome]


def _cut(text: str) -> str:
    return text if len(text) <= 160 else text[:157] + "..."
