# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables, charts and one HTML page from the rows that :mod:`benchmarks.measure` made."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from pathlib import Path
from statistics import mean
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.chart_parts import WORK, name_in, tidy, time_axis, write_names
from benchmarks.measure import SCORED, f1_at
from benchmarks.page import write_html
from benchmarks.speed_charts import speed_figure
from benchmarks.suites import SETTINGS_APART
from benchmarks.surface_charts import surface_figures, surface_tables
from mgf_engine.errors import BadInput
from mgf_engine.stages import STAGE_NAMES

Row = dict[str, Any]
_COLORS = ("#4c78a8", "#f58518", "#54a24b", "#b279a2", "#9d9da1", "#e45756", "#72b7b2", "#eeca3b")
STAGE_COLORS = dict(zip(STAGE_NAMES, itertools.cycle(_COLORS), strict=False))


def write_page(suite: str, rows: list[Row], out: Path, before: list[Row] | None = None) -> Path:
    """Charts as PNG and SVG under ``out/charts`` and ``out/<suite>.html``; returns the page.

    Args:
        before: rows of an earlier version; where they are of the same scene, one more chart shows what moved.
    """
    charts = out / "charts"
    charts.mkdir(parents=True, exist_ok=True)
    done = [row for row in rows if "geometry" in row]
    figures = itertools.chain(_moved_figures(suite, done, before or []), _figures(suite, done))
    overview: list[dict[str, Any]] = []
    if suite == "surfaces":
        figures, overview = itertools.chain(surface_figures(done), figures), surface_tables(done)
    made = [(title, f"charts/{name}.svg") for name, title, figure in figures if _save(figure, charts, name) is not None]
    failed = [row for row in rows if "geometry" not in row]
    tables = overview + summary_tables(done)
    return write_html("page.html.j2", out / f"{suite}.html", suite=suite, charts=made, tables=tables, failed=failed)


def write_chart(suite: str, rows: list[Row], path: Path) -> None:
    """Write the picture of speed against accuracy on all scenes, as PNG.

    Raises:
        BadInput: there is no row with scores, or the file cannot be written.
    """
    done = [row for row in rows if "geometry" in row]
    if not done:
        raise BadInput(f"No run of suite '{suite}' has a result yet, so '{path}' was not drawn.")
    figure = speed_figure(done)
    try:
        figure.savefig(path, dpi=110, format="png")
    except OSError as error:
        raise BadInput(f"Cannot write the chart to '{path}' ({error.strerror}); give another file.") from error
    finally:
        plt.close(figure)


def summary_tables(rows: list[Row]) -> list[dict[str, Any]]:
    """Return one table per scene: a line per variant, the mean over seeds with the spread of F1.

    Returns:
        dicts with ``scene``, ``columns`` (names) and ``lines`` (texts).
    """
    tables = []
    for scene in dict.fromkeys(row["scene"] for row in rows):
        mine = [row for row in rows if row["scene"] == scene]
        thresholds = mine[0]["geometry"]["thresholds"]
        scored = [key for key in SCORED if all(key in row for row in mine)]
        columns = ["variant", "seeds", *(f"{SCORED[key]} {t * 100:.3g} cm" for key in scored for t in thresholds)]
        columns += [
            "accuracy",
            "completeness",
            "cut off",
            "PSNR",
            "whole frame",
            "SSIM",
            "mask IoU",
            "Gaussians",
            "faces",
            "parts",
            "holes",
            "seconds",
            "CPU s",
            "MB",
        ]
        lines = [
            _line(name, [r for r in mine if r["variant"] == name], scored)
            for name in dict.fromkeys(r["variant"] for r in mine)
        ]
        tables.append({"scene": scene, "columns": columns, "lines": lines})
    return tables


def _line(variant: str, rows: list[Row], scored: list[str]) -> list[str]:
    f1 = [values for key in scored for values in zip(*(row[key]["f1"] for row in rows), strict=True)]
    clean = [row["geometry"]["hygiene"] for row in rows]
    return [
        variant,
        str(len(rows)),
        *(f"{mean(v):.1f}" + (f" ±{(max(v) - min(v)) / 2:.1f}" if len(v) > 1 else "") for v in f1),
        *(_average([row["geometry"][key][0] for row in rows], "{:.1f}") for key in ("accuracy", "completeness")),
        _average([row["geometry"]["outside_crop"] for row in rows], "{:.1f}"),
        _average([row.get("psnr") for row in rows], "{:.2f}"),
        _average([row.get("psnr_frame") for row in rows], "{:.2f}"),
        _average([row.get("ssim") for row in rows], "{:.3f}"),
        _average([row.get("mask_iou") for row in rows], "{:.1f}"),
        _average([row.get("gaussians") for row in rows], "{:.0f}"),
        *(_average([c[key] for c in clean], "{:.0f}") for key in ("faces", "components", "holes")),
        *(_average([row[key] for row in rows], "{:.0f}") for key in ("seconds", "cpu_seconds")),
        _average([row["peak_memory"] / 1e6 for row in rows], "{:.0f}"),
    ]


def _average(values: list[Any], form: str) -> str:
    known = [v for v in values if v is not None]
    return form.format(mean(known)) if known else "–"


def _figures(suite: str, rows: list[Row]) -> Iterable[tuple[str, str, Figure]]:
    if rows:
        yield f"{suite}-speed", "all scenes: speed against accuracy", speed_figure(rows)
    for scene in dict.fromkeys(row["scene"] for row in rows):
        mine = [row for row in rows if row["scene"] == scene]
        tag = f"{suite}-{Path(scene).name}"
        if suite == "pareto":
            yield f"{tag}-overview", f"{scene}: speed against accuracy", _overview(mine)
        yield f"{tag}-f1-time", f"{scene}: F1 against work", _scatter(mine, WORK, "f1")
        if any(row.get("psnr") for row in mine):
            yield f"{tag}-psnr-time", f"{scene}: PSNR against work", _scatter(mine, WORK, "psnr")
        for key, name in (("gaussians", "Gaussians"), ("faces", "faces")):
            if any(row.get(key) for row in mine):
                yield f"{tag}-f1-{key}", f"{scene}: F1 against {name}", _scatter(mine, (key, name), "f1")
        if any(row.get("stages") for row in mine):
            yield f"{tag}-seconds", f"{scene}: where each second goes", _stage_bars(mine)


def _moved_figures(suite: str, rows: list[Row], before: list[Row]) -> Iterable[tuple[str, str, Figure]]:
    earlier = [row for row in before if "geometry" in row]
    for scene in dict.fromkeys(row["scene"] for row in rows):
        then = [row for row in earlier if Path(row["scene"]).name == Path(scene).name]
        now = [row for row in rows if row["scene"] == scene]
        if then:
            yield f"{suite}-{Path(scene).name}-moved", f"{scene}: before and now", _moved(now, then)


def _moved(now: list[Row], then: list[Row]) -> Figure:
    """F1 against work, an earlier version hollow and dashed; an arrow leads from each variant to the same one now."""
    figure, axes = plt.subplots(figsize=(7.5, 4.6), layout="constrained")
    threshold = now[0]["geometry"]["thresholds"][0]
    ends = [_work_and_f1(rows, threshold) for rows in (then, now)]
    looks = {"before": {"linestyle": "--", "markerfacecolor": "none", "color": "#9d9da1"}, "now": {"linestyle": "-"}}
    for (name, look), spots in zip(looks.items(), ends, strict=True):
        ordered = sorted(spots.items(), key=lambda spot: spot[1])
        axes.plot(*zip(*(place for _, place in ordered), strict=True), marker="o", label=name, **look)  # type: ignore[arg-type]
        for variant, place in ordered:
            axes.annotate(variant, place, xytext=(4, 4), textcoords="offset points", fontsize=7)
    for variant in ends[0].keys() & ends[1].keys():
        arrow = {"arrowstyle": "->", "color": "#9d9da1", "shrinkA": 5, "shrinkB": 5}
        axes.annotate("", ends[1][variant], ends[0][variant], arrowprops=arrow)
    time_axis(axes, WORK[1])
    axes.margins(x=0.15)  # for the names at the points
    axes.set_ylabel(f"F1 at {threshold * 100:.3g} cm, %")
    tidy(axes, legend=True)
    return figure


def _work_and_f1(rows: list[Row], threshold: float) -> dict[str, tuple[float, float]]:
    """Variant -> CPU seconds and F1 at a threshold, means over its seeds."""

    same = {name: [row for row in rows if row["variant"] == name] for name in (row["variant"] for row in rows)}
    return {
        name: (mean(r["cpu_seconds"] for r in mine), mean(f1_at(r, threshold) for r in mine))
        for name, mine in same.items()
    }


def _overview(rows: list[Row]) -> Figure:
    """F1 and PSNR against the work done, side by side; unlike time, work is the same while other programs run."""
    figure, pair = plt.subplots(1, 2, figsize=(11, 4.6), layout="constrained")
    for axes, y in zip(pair, ("f1", "psnr"), strict=True):
        _curves(axes, rows, WORK, y)
    return figure


def _scatter(rows: list[Row], x: tuple[str, str], y: str) -> Figure:
    figure, axes = plt.subplots(figsize=(7.5, 4.6), layout="constrained")
    _curves(axes, rows, x, y)
    return figure


def _curves(axes: Axes, rows: list[Row], x: tuple[str, str], y: str) -> None:
    """One curve per group over the means of its variants; logarithmic x."""
    threshold = rows[0]["geometry"]["thresholds"][0]
    points: dict[str, list[tuple[float, float, str]]] = {}
    for variant in dict.fromkeys(row["variant"] for row in rows):
        same = [row for row in rows if row["variant"] == variant and row.get(x[0]) is not None]
        values: list[Any] = [row["geometry"]["f1"][0] if y == "f1" else row.get(y) for row in same]
        if not same or any(v is None for v in values):
            continue
        points.setdefault(same[0].get("group") or variant, []).append(
            (float(mean(r[x[0]] for r in same)), float(mean(values)), variant)
        )
    names: list[tuple[str, tuple[float, float], Any]] = []
    for group, spots in points.items():
        spots.sort()
        style = "" if len(spots) == 1 or group.startswith(SETTINGS_APART) else "-"
        (line,) = axes.plot([s[0] for s in spots], [s[1] for s in spots], marker="o", linestyle=style, label=group)
        names += [(name_in(group, name), (work, value), line.get_color()) for work, value, name in spots]
    axes.margins(x=0.15)  # for the names
    time_axis(axes, x[1])
    axes.set_ylabel(f"F1 at {threshold * 100:.3g} cm, %" if y == "f1" else "PSNR inside the mask, held-out views, dB")
    tidy(axes, legend=len(points) > 1)
    write_names(axes, names)


def _stage_bars(rows: list[Row]) -> Figure:
    variants = list(dict.fromkeys(row["variant"] for row in rows if row.get("stages")))
    figure, axes = plt.subplots(figsize=(7.5, 1.2 + 0.32 * len(variants)), layout="constrained")
    left = [0.0] * len(variants)
    for stage, color in STAGE_COLORS.items():
        width = [
            mean(r["stages"].get(stage, 0.0) for r in rows if r["variant"] == v and r.get("stages")) for v in variants
        ]
        axes.barh(variants, width, left=left, color=color, label=stage)
        left = [a + b for a, b in zip(left, width, strict=True)]
    axes.invert_yaxis()
    axes.set_xlabel("seconds")
    tidy(axes, legend=True)
    return figure


def _save(figure: Figure, folder: Path, name: str) -> Path:
    for end in ("png", "svg"):
        figure.savefig(folder / f"{name}.{end}", dpi=130)
    plt.close(figure)
    return folder / f"{name}.svg"
