# SPDX-License-Identifier: GPL-3.0-or-later
"""``town.html``: a map, and for each building a picture, its state, time, confidence and warnings."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mgf_engine.console.terminal import format_duration
from mgf_engine.files.atomic import atomic_path
from mgf_engine.masks.propagation.prompt_messages import asks_for_other_clicks
from mgf_engine.town.hulls import BY_HAND
from mgf_engine.town.map import COLORS
from mgf_engine.town.plan import BUILDINGS
from mgf_engine.town.worker import FAILED, FINISHED, PICTURE, RUNNING, STOPPED, WAITING

#: Colour of what a job is at; buildings without a job have that of their state.
JOB_COLORS = {WAITING: "#adb5bd", RUNNING: "#1c7ed6", FINISHED: "#2b8a3e", FAILED: "#c92a2a", STOPPED: "#e67700"}
_WIDTH = 760.0  # of the map, pixels
_LETTERS = (7.0, 12.0)  # px
_LETTER = 0.6  # width of a letter over its height, on average


def write_page(path: Path, town: Path, rows: list[dict[str, Any]], refresh: int = 0, files: Sequence[str] = ()) -> None:
    """Write the page.

    Args:
        path: of the page.
        town: folder of the town.
        rows: of :func:`mgf_engine.town.result.read_rows`.
        refresh: seconds after which a browser asks for it again; 0 never.
        files: what came back, which the page names as far as it is there.
    """
    from jinja2 import Environment, PackageLoader, select_autoescape

    environment = Environment(loader=PackageLoader("mgf_engine.town", ""), autoescape=select_autoescape())
    shapes, height, bar, length = _shapes(town, rows)
    shown = [_shown(row, town) for row in rows]
    counts = {kind: sum(row["job"] == kind for row in rows) for kind in JOB_COLORS}
    text = environment.get_template("town.html.j2").render(
        rows=shown, shapes=shapes, width=_WIDTH, height=height, refresh=refresh, colors=JOB_COLORS, states=COLORS,
        counts={k: n for k, n in counts.items() if n}, bar=bar, length=length,
        seconds=format_duration(sum(row["done"].get("job_seconds", 0.0) for row in rows)),
        picture=_data(town / "map.png", "png"), files=[name for name in files if (town / name).is_file()],
    )  # fmt: skip
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def color_of(row: dict[str, Any]) -> str:
    """Return the colour of a building on the map."""
    return JOB_COLORS[row["job"]] if row["job"] else COLORS[row["state"]]


def _shapes(town: Path, rows: list[dict[str, Any]]) -> tuple[list[dict[str, Any]], float, float, str]:
    """Return the footprints as SVG paths, the height of the map, and a scale bar in pixels with its label."""
    features = json.loads((town / "buildings.geojson").read_text(encoding="utf-8"))["features"]
    metre = float(json.loads((town / "buildings.json").read_text(encoding="utf-8"))["metre"])
    outlines = [_rings(feature["geometry"]) for feature in features]
    corners = np.concatenate([ring for rings in outlines for ring in rings] or [np.zeros((1, 2))])
    low, high = corners.min(0), corners.max(0)
    margin = 0.05 * max(float((high - low).max()), 1e-9)
    low, high = low - margin, high + margin
    scale = min(_WIDTH / (high - low)[0], 900.0 / (high - low)[1])
    found = []
    for row, rings in zip(rows, outlines, strict=True):
        paths = []
        for ring in rings:
            at = (ring - (low[0], high[1])) * (scale, -scale)
            paths.append("M" + " L".join(f"{x:.1f},{y:.1f}" for x, y in at) + "Z")
        middle = (rings[0][:-1].mean(0) - (low[0], high[1])) * (scale, -scale)
        found.append({
            "id": row["id"], "path": " ".join(paths), "x": middle[0], "y": middle[1], "color": color_of(row),
            "letters": _letters(row["id"], float(np.ptp(rings[0][:, 0])) * scale),
        })  # fmt: skip
    metres = 10.0 ** np.floor(np.log10(max(0.3 * _WIDTH / scale / metre, 1e-9)))
    return found, float((high - low)[1] * scale), float(metres * metre * scale), f"{metres:g} m"


def _letters(name: str, width: float) -> float:
    """Return the height of letters in pixels with which a name stays over a building so wide, as far as one can still
    read it."""
    return round(float(np.clip(width / (_LETTER * max(len(name), 1)), *_LETTERS)), 1)


def _rings(geometry: dict[str, Any]) -> list[Any]:
    parts = geometry["coordinates"] if geometry["type"] == "MultiPolygon" else [geometry["coordinates"]]
    return [np.array(ring, float)[:, :2] for part in parts for ring in part]


def _shown(row: dict[str, Any], town: Path) -> dict[str, Any]:
    """Return the row of a building as the template shows it."""
    status, done, measured = row["status"], row["done"], row.get("measured", {})
    folder = town / BUILDINGS / row["id"]
    report = folder / "job" / "report.html"
    notes = [row["reason"], status.get("text", "") if row["job"] in (FAILED, STOPPED) else ""]
    second = done.get("attempt", status.get("attempt", 1)) > 1
    warnings = done.get("warnings", status.get("warnings", []))
    if row["state"] != BY_HAND:
        warnings = [text for text in warnings if not asks_for_other_clicks(text)]
    return {
        "id": row["id"], "state": row["state"], "job": row["job"], "color": color_of(row),
        "stage": status.get("stage", "") if row["job"] == RUNNING else "",
        "overall": f"{status.get('overall', 0.0):.0%}" if row["job"] == RUNNING else "",
        "height": measured.get("height", row["height"]), "area": row["area"], "volume": measured.get("volume"),
        "photos": len(row["photos"]), "pixel": round(100 * row["pixel"], 1),
        "seconds": format_duration(done["job_seconds"]) if done.get("job_seconds") else "",
        "confidence": done.get("confidence"), "notes": [note for note in notes if note],
        "second": second, "warnings": warnings,
        "picture": _data(folder / PICTURE, "jpeg") if done else "",
        "report": report.relative_to(town).as_posix() if report.is_file() else "",
    }  # fmt: skip


def _data(path: Path, kind: str) -> str:
    """Return a picture as a link that holds it, so that the page is one file; empty where there is none."""
    if not path.is_file():
        return ""
    return f"data:image/{kind};base64,{base64.b64encode(path.read_bytes()).decode()}"
