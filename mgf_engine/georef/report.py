# SPDX-License-Identifier: GPL-3.0-or-later
"""The report's section on the georeference: facts, tables of residuals of points and bars, and a plot."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgf_engine.georef.control_points import CHECK, CONTROL
from mgf_engine.georef.find import GeoreferenceFit
from mgf_engine.georef.fit_control import ControlFit, ControlRow
from mgf_engine.model.scene import Scene

BEGIN, END = "<!-- georeference -->", "<!-- /georeference -->"
_HOW = {
    "none": "not at all", "gps": "GPS of the photos", "control": "control points",
    "scale_bars": "scale bars and the direction up", "up": "only the direction up is known",
}  # fmt: skip
_BLUE, _ORANGE = "#2563eb", "#c2410c"
_MOST_BARS = 40
Bar = tuple[str, float, str]  # name, length and colour
_UP = {"walls": "vertical edges of the building", "tags": "the photos' gravity tags", "cameras": "level cameras"}


def georeference_html(fit: GeoreferenceFit, scene: Scene) -> str:
    """Return the section of the report, between two marks by which a later one finds and replaces it."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("mgf_engine", "georef"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    text = environment.get_template("report.html.j2").render(
        facts=facts(fit), notes=fit.notes, points=_point_rows(fit), bars=fit.bars,
        picture=_picture(fit, scene), metric=fit.georeference.metric,
    )  # fmt: skip
    return f"{BEGIN}\n{text}\n{END}"


def georeference_figures(fit: GeoreferenceFit) -> dict[str, Any]:
    """Return the same for ``report.json``: plain data, metres and pixels."""
    now = fit.georeference
    points = [] if fit.control is None else [_figures_of(row) for row in fit.control.rows]
    return {
        "method": now.method, "crs": now.crs, "unit": now.unit, "offset": list(now.offset), "scale": now.scale,
        "heights": now.heights, "accuracy": dict(now.accuracy), "up": fit.up.method, "up_degrees": fit.up.degrees,
        "points": points,
        "bars": [{"name": r.bar.name, "given": r.bar.length, "found": r.found, "used": r.used} for r in fit.bars],
        "gps_photos": len(fit.gps_views), "gps_used": 0 if fit.gps is None else int(fit.gps.used.sum()),
        "notes": list(fit.notes),
    }  # fmt: skip


def rms_figures(fit: GeoreferenceFit) -> dict[str, str]:
    """Return RMSE in space of control and check points, for the last line of a run."""
    return {f"RMSE of {role} points": f"{1000 * total:.1f} mm" for role, _, total in _rmse(fit)}


def _rmse(fit: GeoreferenceFit) -> Iterator[tuple[str, NDArray[np.float64], float]]:
    """Yield role and RMSE of control and check points, metres: along each axis [3], and in space."""
    for role in (CONTROL, CHECK):
        rms = None if fit.control is None else fit.control.rms(role)
        if rms is not None:
            yield role, rms, float(np.sqrt((rms**2).sum()))


def facts(fit: GeoreferenceFit) -> list[tuple[str, str]]:
    """Return label and text of what is known."""
    now = fit.georeference
    rows = [("found by", _HOW[now.method]), ("coordinates", now.crs or f"local frame, {now.unit}")]
    if any(now.offset):
        rows.append(("offset (easting, northing, height)", "{:.3f}, {:.3f}, {:.3f}".format(*now.offset)))
    if now.origin is not None:
        rows.append(("latitude and longitude of the origin", "{:.7f}, {:.7f}".format(*now.origin)))
    if now.heights:
        rows.append(("heights", now.heights))
    if now.metric:
        rows.append(("metres per unit of the scene", f"{now.scale:.6g}"))
    up = f"{_UP[fit.up.method]}, to {fit.up.degrees:.2f} degrees"
    rows.append(("direction up by itself", f"{up} ({fit.up.edges} edges)" if fit.up.edges else up))
    if fit.gps is not None:
        x, y, z = fit.gps.rms
        used = f"{int(fit.gps.used.sum())} of {len(fit.gps_views)} photos"
        rows.append(("GPS", f"{used}; off by {x:.2f} m east, {y:.2f} m north, {z:.2f} m in height (RMS)"))
    for role, rms, total in _rmse(fit):
        x, y, z = 1000 * rms
        text = f"east {x:.1f}, north {y:.1f}, height {z:.1f}, together {1000 * total:.1f} mm"
        rows.append((f"RMSE of {role} points", text))
    return rows


def _point_rows(fit: GeoreferenceFit) -> list[dict[str, Any]]:
    """Return the rows of the table of control and check points, and of their RMSE."""
    if fit.control is None:
        return []
    rows = []
    for row in fit.control.rows:
        values = [*row.residual, row.distance]
        rows.append({
            "name": row.point.name, "role": row.point.role, "millimetres": [_millimetres(v) for v in values],
            "pixels": "–" if np.isnan(row.pixels) else f"{row.pixels:.2f}", "photos": row.photos, "note": row.note,
            "mean": False,
        })  # fmt: skip
    for role, rms, total in _rmse(fit):
        rows.append({
            "name": "RMSE", "role": role, "millimetres": [f"{1000 * v:.1f}" for v in (*rms, total)], "pixels": "",
            "photos": "", "note": "", "mean": True,
        })  # fmt: skip
    return rows


def _millimetres(value: float) -> str:
    return "–" if np.isnan(value) else f"{1000 * value:+.1f}"


def _figures_of(row: ControlRow) -> dict[str, Any]:
    return {
        "name": row.point.name, "role": row.point.role, "residual": list(row.residual), "distance": row.distance,
        "pixels": row.pixels, "photos": row.photos, "used": row.used, "note": row.note,
    }  # fmt: skip


def _picture(fit: GeoreferenceFit, scene: Scene) -> str:
    """Draw a plan with cameras, points and residuals as arrows, and the residuals in height; empty where there are
    none."""
    if fit.control is None and fit.gps is None:
        return ""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    now = fit.georeference
    figure, (plan, side) = pyplot.subplots(1, 2, figsize=(11, 5), width_ratios=(3, 2), layout="constrained")
    centres = now.local(scene.to_normalised.invert(np.array([view.centre for view in scene.views])))
    plan.scatter(centres[:, 0], centres[:, 1], 8, "0.7", label="cameras")
    if fit.control is not None:
        draw_bars(side, _draw_points(plan, fit.control, now.offset))
        side.set_xlabel("height, scene less file (mm)")
    elif fit.gps is not None:
        used = fit.gps.used
        own = centres[list(fit.gps_views)][used]
        _arrows(plan, own, fit.gps.residuals[used], _BLUE, "camera less GPS", 1, "m")
        names = [Path(scene.views[i].name).name for i, ok in zip(fit.gps_views, used, strict=True) if ok]
        heights = fit.gps.residuals[used, 2].tolist()
        draw_bars(side, [(name, height, _BLUE) for name, height in zip(names, heights, strict=True)][:_MOST_BARS])
        side.set_xlabel("height, camera less GPS (m)")
    plan.set_aspect("equal", "datalim")
    plan.set_xlabel("east (m)")
    plan.set_ylabel("north (m)")
    plan.legend(fontsize=8)
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=110)
    pyplot.close(figure)
    return "data:image/png;base64," + base64.b64encode(data.getvalue()).decode("ascii")


def _draw_points(plan: Any, control: ControlFit, offset: tuple[float, float, float]) -> list[Bar]:
    """Draw control and check points with their residuals; returns the residuals in height, mm."""
    bars = list[Bar]()
    for role, color in ((CONTROL, _BLUE), (CHECK, _ORANGE)):
        rows = [r for r in control.rows if r.point.role == role and np.isfinite(r.distance)]
        if not rows:
            continue
        places = _places(rows, offset)
        _arrows(plan, places, np.array([r.residual for r in rows]), color, role, 1000, "mm")
        for row, at in zip(rows, places, strict=True):
            plan.annotate(row.point.name, at[:2], textcoords="offset points", xytext=(5, 4), fontsize=8)
        bars += [(row.point.name, 1000 * row.residual[2], color) for row in rows]
    return bars


def draw_bars(axes: Any, bars: Sequence[Bar]) -> None:
    """Draw a bar for each name, length and colour, the first on top; names may occur twice."""
    names, lengths, colors = ([bar[k] for bar in bars] for k in range(3))
    axes.barh(range(len(bars)), lengths, color=colors, tick_label=names)
    axes.axvline(0, color="0.5", linewidth=0.8)
    axes.invert_yaxis()
    axes.tick_params(labelsize=7 if len(bars) > 15 else 9)


def _places(rows: list[ControlRow], offset: tuple[float, float, float]) -> NDArray[np.float64]:
    return np.array([row.point.position for row in rows]) - np.array(offset)


def _arrows(
    axes: Any, at: NDArray[np.float64], residuals: NDArray[np.float64], color: str, label: str, factor: int, unit: str
) -> None:
    """Draw points with their residuals, the longest an eighth of the plan's extent; the label says how long that is."""
    longest = float(np.linalg.norm(residuals[:, :2], axis=1).max()) or 1e-9
    extent = float(np.ptp(at[:, :2], axis=0).max()) or 1.0
    grown = residuals[:, :2] * (extent / 8 / longest)
    axes.scatter(at[:, 0], at[:, 1], 22, color, label=f"{label}, longest arrow {factor * longest:.3g} {unit}")
    axes.quiver(
        at[:, 0], at[:, 1], grown[:, 0], grown[:, 1], angles="xy", scale_units="xy", scale=1, color=color, width=0.004
    )
