# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of the georeference: marks as ``mgf georef`` reads them, and what the engine wrote about points and residuals.

What the engine wrote is read again whenever the file changes; nothing of it is kept in the .blend.
"""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..common.errors import UserError, reason
from ..common.files import replace_file
from ..common.json_cache import JsonCache
from .properties import set_mark


@dataclass(frozen=True)
class KnownPoint:
    """A point as the engine knows it.

    Attributes:
        by: what its place is known by: its marks, other points, the georeference; empty where it is not.
        pixels: how far its marks lie from it, RMS; None without two marks.
        wrong: photos whose mark the others contradict.
        photos: photo -> x, y and the radius to look within, pixels of the photo as taken.
    """

    name: str
    role: str
    by: str
    pixels: float | None
    wrong: tuple[str, ...]
    photos: dict[str, tuple[float, float, float]]


@dataclass(frozen=True)
class PointResiduals:
    """A point's residuals in metres (NaN where it could not be placed) and pixels, and what is to be said of it."""

    name: str
    role: str
    residual: tuple[float, float, float]
    pixels: float
    note: str


@dataclass(frozen=True)
class Placement:
    """``georef.json``: scene frame -> local frame, and the local frame's place in the world."""

    to_local: np.ndarray
    offset: tuple[float, float, float]
    crs: str
    metric: bool
    north_known: bool
    origin: tuple[float, float, float] | None


def marks_path(job: Path) -> Path:
    """Return where the marks are written for a run; beside the job folder, as its clicks are."""
    return job.with_name(job.name + ".marks.csv")


def places_path(job: Path) -> Path:
    """Return where the engine writes where points should appear."""
    return job.with_name(job.name + ".places.json")


def marks_text(scene: bpy.types.Scene) -> str:
    """Return the scene's marks as a CSV: name, photo, x, y."""
    text = io.StringIO()
    rows = [(m.point, m.photo, f"{m.uv[0]:.2f}", f"{m.uv[1]:.2f}") for m in scene.mgf.georef.marks]
    csv.writer(text, lineterminator="\n").writerows([("name", "photo", "x", "y"), *rows])
    return text.getvalue()


def write_marks(scene: bpy.types.Scene, path: Path) -> None:
    """Write the marks, whole or not at all.

    Raises:
        UserError: the file cannot be written.
    """
    text = marks_text(scene)
    replace_file(path, lambda temporary: temporary.write_text(text, encoding="utf-8", newline=""))


def read_marks(scene: bpy.types.Scene, path: Path) -> int:
    """Take over the marks of a CSV with the heading name, photo, x, y; returns how many.

    Raises:
        UserError: the file cannot be read or is none; the scene is then unchanged.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = [(r["name"], r["photo"], (float(r["x"]), float(r["y"]))) for r in csv.DictReader(file)]
        if not rows or not all(math.isfinite(v) for *_, uv in rows for v in uv):
            raise ValueError("no marks")
    except OSError as error:
        raise UserError(
            "Cannot read '{path}' ({error}); choose a CSV of marks.", path=path, error=reason(error)
        ) from error
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        raise UserError("'{path}' is no file of marks; its heading should be name, photo, x, y.", path=path) from error
    for point, photo, uv in rows:
        set_mark(scene, point, photo, uv)
    return len(rows)


def read_known_points(job: Path) -> dict[str, KnownPoint]:
    """Read the control points by name, as the engine read them from the user's file; empty before it did."""
    return _points_files.get(places_path(job)) or {}


def read_residuals(job: Path) -> list[PointResiduals]:
    """Read residuals of the last run's points, from ``report.json``."""
    return _report_files.get(job / "report.json") or []


def rmse(residuals: list[PointResiduals], role: str) -> float | None:
    """Return the root mean square distance of the points of a role from where they should be, metres; None without
    any that could be placed and agree with the others."""
    squares = [sum(v * v for v in r.residual) for r in residuals
               if r.role == role and not r.note and math.isfinite(r.residual[0])]  # fmt: skip
    return math.sqrt(sum(squares) / len(squares)) if squares else None


def read_placement(job: Path) -> Placement | None:
    """Read the job's georeference."""
    return _placement_files.get(job / "georef.json")


def _known_points(path: Path, data: dict[str, Any]) -> dict[str, KnownPoint]:
    found = {}
    for entry in data["points"]:
        photos = {str(name): _three(values) for name, values in entry["photos"].items()}
        found[str(entry["name"])] = KnownPoint(
            str(entry["name"]), str(entry["role"]), str(entry["by"]),
            None if entry["pixels"] is None else float(entry["pixels"]), tuple(map(str, entry["wrong"])), photos,
        )  # fmt: skip
    return found


def _residuals(path: Path, data: dict[str, Any]) -> list[PointResiduals]:
    return [
        PointResiduals(
            str(p["name"]), str(p["role"]), _three([math.nan if v is None else v for v in p["residual"]]),
            math.nan if p["pixels"] is None else float(p["pixels"]), str(p["note"]),
        )
        for p in data["georeference"]["points"]
    ]  # fmt: skip


def _placement(path: Path, data: dict[str, Any]) -> Placement:
    matrix = np.array(data["to_local"], np.float64)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all() or not np.linalg.det(matrix[:3, :3]) > 0:
        raise ValueError("to_local")
    origin = None if data["origin"] is None else _three(data["origin"])
    metric, north_known = data["unit"] == "metre", bool(data["north_known"])
    return Placement(matrix, _three(data["offset"]), str(data["crs"] or ""), metric, north_known, origin)


def _three(values: Any) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z


_points_files, _report_files, _placement_files = JsonCache(_known_points), JsonCache(_residuals), JsonCache(_placement)
