# SPDX-License-Identifier: GPL-3.0-or-later
"""Charts and tables of ``mgf bench surfaces``: every scene and every material, ours and other tools side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from statistics import mean
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from benchmarks.chart_parts import WORK, tidy, time_axis
from benchmarks.measure import THRESHOLDS, f1_at

Row = dict[str, Any]
#: The generator's materials by what makes them hard; a material that is in none is "other".
CLASSES: dict[str, tuple[str, ...]] = {
    "plain plaster": ("white", "clean_white", "clean_ochre", "plaster", "clay"),
    "plain roof": ("clean_red", "clean_grey"),
    "brick and stone": ("brick", "stone", "ashlar", "sandstone"),
    "tiles": ("tiles", "ridge_tiles", "shingles", "felt", "gravel"),
    "slate and dark metal": ("slate", "dark_metal"),
    "shiny metal": ("shiny_sheet", "alu", "metal", "metal_door", "steel", "sheet", "copper"),
    "glass": ("glass", "mirror_glass", "spandrel"),
    "wood": ("timber", "cladding", "wood", "wood_trim", "frame"),
    "concrete": ("concrete", "raw_concrete"),
}


def material_class(material: str) -> str:
    """Return the class of a material of the generator."""
    return next((name for name, members in CLASSES.items() if material in members), "other")


def class_scores(rows: Iterable[Row]) -> dict[str, dict[str, Any]]:
    """Scores by class of material over the runs of one variant.

    Returns:
        class -> ``share`` of the true surface in percent, ``f1`` at each of :data:`THRESHOLDS`, ``normal_median`` and
        ``normal_90`` in degrees: means over the materials of all runs, weighted by their share; a class with no
        measured angle has None.
    """
    found: dict[str, list[tuple[float, Row, Row]]] = {}
    rows = list(rows)
    for row in rows:
        for material, scores in row["geometry"].get("materials", {}).items():
            found.setdefault(material_class(material), []).append((scores["share"], scores, row))
    order = [name for name in (*CLASSES, "other") if name in found]
    return {name: _class_means(found[name], len(rows)) for name in order}


def _class_means(entries: list[tuple[float, Row, Row]], runs: int) -> dict[str, Any]:
    def weighted(value: Callable[[Row, Row], float | None]) -> float | None:
        known = [(w, v) for w, v in ((share, value(scores, row)) for share, scores, row in entries) if v is not None]
        return sum(w * v for w, v in known) / sum(w for w, _ in known) if known else None

    def f1(threshold: float) -> float | None:
        return weighted(lambda scores, row: scores["f1"][row["geometry"]["thresholds"].index(threshold)])

    return {
        "share": sum(share for share, _, _ in entries) / runs,
        "f1": [f1(threshold) for threshold in THRESHOLDS],
        "normal_median": weighted(lambda scores, row: scores["normal_median"]),
        "normal_90": weighted(lambda scores, row: scores["normal_90"]),
    }


def variants_of(rows: Iterable[Row]) -> dict[str, list[Row]]:
    """Variant -> its rows, in the order of their first rows."""
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(row["variant"], []).append(row)
    return found


def common_scenes(rows: Iterable[Row]) -> set[str]:
    """Return the scenes that every variant did: only over these are their means alike."""
    done = [{row["scene"] for row in mine} for mine in variants_of(rows).values()]
    return set.intersection(*done) if done else set()


def surface_tables(rows: list[Row]) -> list[dict[str, Any]]:
    """Return two tables for the page: every scene, and every class of material; F1 at 5, 10 and 20 cm."""
    variants = variants_of(rows)
    lines = [
        [scene, *(_cell(variants[name], lambda r, s=scene: r["scene"] == s) for name in variants)]  # type: ignore[misc]
        for scene in dict.fromkeys(row["scene"] for row in rows)
    ]
    common = common_scenes(rows)
    if common:
        lines.append(["mean of what all did", *(_cell(variants[n], lambda r: r["scene"] in common) for n in variants)])
    tables = [{"scene": "All scenes: F1 at 5 / 10 / 20 cm; CPU s", "columns": ["scene", *variants], "lines": lines}]
    scores = {n: class_scores([r for r in mine if r["scene"] in common]) for n, mine in variants.items()}
    classes = [name for name in (*CLASSES, "other") if any(name in mine for mine in scores.values())]
    if classes:
        title = "By material, over the scenes that all did: F1 at 5 / 10 / 20 cm; normals, median and 90 %"
        by_class = [[name, *(_class_cell(scores[n].get(name)) for n in variants)] for name in classes]
        tables.append({"scene": title, "columns": ["material", *variants], "lines": by_class})
    return tables


def _cell(rows: list[Row], wanted: Callable[[Row], bool]) -> str:
    mine = [row for row in rows if wanted(row)]
    if not mine:
        return "–"
    f1 = " / ".join(f"{mean(f1_at(row, t) for row in mine):.1f}" for t in THRESHOLDS)
    return f"{f1}; {mean(row['cpu_seconds'] for row in mine):.0f}"


def _class_cell(scores: dict[str, Any] | None) -> str:
    if scores is None:
        return "–"
    angles = (scores["normal_median"], scores["normal_90"])
    turned = "–" if None in angles else "{:.1f}°, {:.1f}°".format(*angles)
    return " / ".join(f"{value:.1f}" for value in scores["f1"]) + f"; {turned}"


def surface_figures(rows: list[Row]) -> Iterable[tuple[str, str, Figure]]:
    """Return name, title and figure of the charts: F1 against CPU seconds, and by material where that was measured."""
    if not rows:
        return
    yield "surfaces-f1-cpu", "F1 against work, all scenes", _work_figure(rows)
    if any(row["geometry"].get("materials") for row in rows):
        yield "surfaces-materials", "F1 by material", _material_figure(rows)


def _work_figure(rows: list[Row]) -> Figure:
    """A small point per scene and a large one for the mean of what all did, at 5, 10 and 20 cm beside each other."""
    common = common_scenes(rows)
    figure, row_of_axes = plt.subplots(1, len(THRESHOLDS), figsize=(12, 4.4), layout="constrained", sharex=True)
    for axes, threshold in zip(row_of_axes, THRESHOLDS, strict=True):
        for number, (name, mine) in enumerate(variants_of(rows).items()):
            x, y = [r["cpu_seconds"] for r in mine], [f1_at(r, threshold) for r in mine]
            axes.scatter(x, y, s=14, alpha=0.5, color=f"C{number}")
            shared = [r for r in mine if r["scene"] in common] or mine
            middle = mean(r["cpu_seconds"] for r in shared), mean(f1_at(r, threshold) for r in shared)
            axes.scatter(*middle, s=90, color=f"C{number}", edgecolor="black", label=name, zorder=3)
        time_axis(axes, WORK[1])
        axes.set_ylabel(f"F1 at {threshold * 100:.3g} cm, %")
        tidy(axes, legend=True)
    return figure


def _material_figure(rows: list[Row]) -> Figure:
    """A group of bars per class of material, one bar per variant, at 10 cm, over the scenes that all did."""
    common = common_scenes(rows)
    shared = [row for row in rows if row["scene"] in common] or rows
    scores = {name: class_scores(mine) for name, mine in variants_of(shared).items()}
    classes = [name for name in (*CLASSES, "other") if any(name in mine for mine in scores.values())]
    figure, axes = plt.subplots(figsize=(7.5, 1.2 + 0.5 * len(classes)), layout="constrained")
    thick = 0.8 / len(scores)
    for number, (name, mine) in enumerate(scores.items()):
        places = [k + (number - (len(scores) - 1) / 2) * thick for k in range(len(classes))]
        values = [mine[c]["f1"][1] if c in mine else 0.0 for c in classes]
        axes.barh(places, values, height=thick, color=f"C{number}", label=name)
    axes.set_yticks(range(len(classes)), classes)
    axes.invert_yaxis()
    axes.set_xlim(0, 100)
    axes.set_xlabel(f"F1 at {THRESHOLDS[1] * 100:.3g} cm, %")
    tidy(axes, legend=True)
    return figure
