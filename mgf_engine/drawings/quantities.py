# SPDX-License-Identifier: GPL-3.0-or-later
"""Quantities of a building: areas, window shares, heights, volume, and how plumb and even its walls are."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from shapely import Polygon

from mgf_engine.drawings.ground import GroundLevel
from mgf_engine.drawings.model import Facade, Polyline, Survey
from mgf_engine.drawings.project import GridBuffers
from mgf_engine.drawings.vector_files import layer_name
from mgf_engine.files.atomic import atomic_path
from mgf_engine.mesh.plane_detection import Planes
from mgf_engine.options.algorithms import parameter

Row = tuple[str, str, str, str]  # of what, quantity, value, unit


@dataclass(frozen=True)
class QuantityOptions:
    """Options of the quantities."""

    wall_distance: float = parameter(6.0, "Largest distance of a surface from the plane of its wall", "ground px")
    facing: float = parameter(0.8, "Smallest cosine between the normals of a surface and its wall", high=1)
    roof_tilt: tuple[float, float] = parameter((10.0, 75.0), "Range of the tilt of roof planes", "degrees", high=90)


def small_unit(survey: Survey) -> str:
    """Return the name of a thousandth of the local unit."""
    return "mm" if survey.georeference.metric else "1/1000 units"


def wall_rows(survey: Survey, facade: Facade, deviation: NDArray[np.float32], parts: Sequence[Polyline]) -> list[Row]:
    """Measure a facade.

    Args:
        survey: mesh in the local frame.
        facade: its plane.
        deviation: of the wall from its plane in the local unit, NaN beside it, [H, W].
        parts: outlines of windows, doors and other named parts on it.
    """
    small = small_unit(survey)
    unit, wall = survey.unit, survey.areas[facade.wall].sum()
    tilt_unit = f"{small} per {unit}" if survey.georeference.metric else "1/1000"
    facing = (survey.normals @ facade.frame.normal > 0.7) & (np.abs(survey.normals[:, 2]) < 0.5)
    all_walls = float(survey.areas[facing].sum())
    known = deviation[np.isfinite(deviation)]
    rows = [
        (facade.name, "width", f"{facade.frame.size[0]:.3f}", unit),
        (facade.name, "height", f"{facade.frame.size[1]:.3f}", unit),
        (facade.name, "area of all walls facing it", f"{all_walls:.2f}", f"{unit}2"),
        (facade.name, "area of its largest plane", f"{wall:.2f}", f"{unit}2"),
        (facade.name, "tilt outwards", f"{1000 * np.tan(np.radians(facade.tilt)):z.1f}", tilt_unit),
    ]
    if len(known):
        rows.append((facade.name, "deviation from the plane, RMS", f"{1000 * np.sqrt((known**2).mean()):.1f}", small))
        low, high = (1000 * float(np.percentile(known, p)) for p in (1, 99))
        rows.append((facade.name, "deviation, 1st percentile", f"{low:z.1f}", small))
        rows.append((facade.name, "deviation, 99th percentile", f"{high:z.1f}", small))
    for layer in sorted({line.layer for line in parts}):
        area = sum(Polygon(line.points).area for line in parts if line.layer == layer)
        name = layer_name(layer)
        rows.append((facade.name, f"area of {name}", f"{area:.2f}", f"{unit}2"))
        if all_walls > 0:
            rows.append((facade.name, f"share of {name}", f"{100 * area / all_walls:.1f}", "%"))
    return rows


def building_rows(
    survey: Survey, planes: Planes, ground: GroundLevel, options: QuantityOptions = QuantityOptions()
) -> list[Row]:
    """Return heights over the ground, roof planes, and the volume where the mesh is closed.

    Args:
        survey: mesh in the local frame.
        planes: of its faces.
        ground: what heights are counted from.
        options: which planes are roofs.
    """
    import trimesh

    unit, z = survey.unit, survey.mesh.vertices[:, 2]
    rows: list[Row] = [("building", "ground is known from", ground.source, "")]
    if survey.georeference.metric:
        level = survey.world(np.array([0.0, 0.0, ground.height]))[2]
        rows.append(("building", "height of the ground", f"{level:.3f}", unit))
    rows.append(("building", "highest point over the ground", f"{float(z.max()) - ground.height:.3f}", unit))
    eaves, ridges = [], []
    for k, normal in enumerate(planes.normals):
        tilt = float(np.degrees(np.arccos(np.clip(normal[2], -1, 1))))
        faces = planes.label == k
        if options.roof_tilt[0] < tilt < options.roof_tilt[1] and faces.any():
            heights = z[survey.mesh.faces[faces]].ravel() - ground.height
            low, high = float(np.percentile(heights, 2)), float(np.percentile(heights, 98))
            area = float(survey.areas[faces].sum())
            eaves.append((low, area))
            ridges.append(high)
            name = f"roof {len(ridges)}"
            rows.append((name, "area", f"{area:.2f}", f"{unit}2"))
            rows.append((name, "tilt", f"{tilt:.2f}", "degrees"))
            rows.append((name, "lower edge over the ground", f"{low:.3f}", unit))
            rows.append((name, "upper edge over the ground", f"{high:.3f}", unit))
    if ridges:
        largest = max(eaves, key=lambda pair: pair[1])[0]
        rows.append(("building", "eaves of the largest roof plane over the ground", f"{largest:.3f}", unit))
        rows.append(("building", "ridge over the ground", f"{max(ridges):.3f}", unit))
    body = trimesh.Trimesh(survey.mesh.vertices - survey.mesh.vertices.mean(0), survey.mesh.faces, process=False)
    if body.is_watertight:
        rows.append(("building", "volume", f"{abs(float(body.volume)):.2f}", f"{unit}3"))
    else:
        rows.append(("building", "volume", "", "the mesh is open; mesh it with --close-bottom"))
    return rows


def wall_deviation(
    survey: Survey, facade: Facade, seen: GridBuffers, options: QuantityOptions = QuantityOptions()
) -> NDArray[np.float32]:
    """Compute the distance of the wall before its plane of least squares at each pixel, NaN beside it, [H, W].

    Args:
        survey: mesh of the job, local frame.
        facade: the wall.
        seen: faces and depths at the pixels, [H, W].
        options: limits of what belongs to the wall.
    """
    weight, at = survey.areas[facade.wall], facade.frame.to_drawing(survey.centres[facade.wall])
    terms = np.column_stack([at[:, :2], np.ones(len(at))]) * np.sqrt(weight)[:, None]
    a, b, c = np.linalg.lstsq(terms, at[:, 2] * np.sqrt(weight), rcond=1e-9)[0]
    grid = seen.grid
    x = grid.left + (np.arange(grid.width) + 0.5) * grid.resolution
    y = grid.top - (np.arange(grid.height) + 0.5) * grid.resolution
    off = (seen.before - (a * x + c)[None] - (b * y)[:, None]) / np.sqrt(a * a + b * b + 1)
    facing = (survey.normals @ facade.frame.normal > options.facing)[seen.face] & (seen.face >= 0)
    return np.where(facing & (np.abs(off) < options.wall_distance * survey.working_pixel), off, np.nan).astype(
        np.float32
    )


def deviation_picture(deviation: NDArray[np.float32], small: str = "mm") -> NDArray[np.uint8]:
    """Colour blue behind the plane, white on it, red before it, RGBA [H, W, 4]; full colour at the 98th percentile.

    A colour bar is added below, so the picture has more rows than the map; its ends are in thousandths of the unit,
    which ``small`` names.
    """
    known = np.isfinite(deviation)
    limit = max(float(np.percentile(np.abs(deviation[known]), 98)) if known.any() else 1.0, 1e-9)
    share = np.clip(np.nan_to_num(deviation) / limit, -1, 1)[..., None]
    color = _share_color(share)
    picture = np.zeros((*deviation.shape, 4), np.uint8)
    picture[..., :3], picture[..., 3] = color.round(), 255 * known
    picture[~known] = 0
    return np.concatenate([picture, _color_bar(limit, picture.shape[1], small)])


def _color_bar(limit: float, width: int, small: str) -> NDArray[np.uint8]:
    """Draw the colour bar below a picture ``width`` pixels wide, RGBA: blue behind, red before."""
    size = max(width, 240) / 1000  # of the letters, so that they can be read where the picture is shown whole
    high, wide = int(60 * size) + 24, min(width, int(500 * size) + 100)
    bar = np.full((high, width, 3), 255, np.uint8)
    share = np.linspace(-1, 1, wide)[:, None]
    bar[4 : high // 3, :wide] = _share_color(share).round()
    for text, at in ((f"-{1000 * limit:.3g} {small}", 0.0), ("0", 0.5), (f"+{1000 * limit:.3g} {small}", 1.0)):
        scale = 0.35 + 0.5 * size
        (length, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)
        place = (round(at * (wide - length)), high - 6)
        cv2.putText(bar, text, place, cv2.FONT_HERSHEY_SIMPLEX, scale, (0, 0, 0), 1, cv2.LINE_AA)
    return np.dstack([bar, np.full((high, width), 255, np.uint8)])


def _share_color(share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return colours of shares -1..1 [..., 1] of the largest deviation, RGB 0..255 [..., 3]."""
    white, red, blue = np.full(3, 245.0), np.array([190.0, 20, 40]), np.array([30.0, 70, 190])
    return np.asarray(np.where(share > 0, white + share * (red - white), white - share * (blue - white)))


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """Write the rows with a heading."""
    text = io.StringIO()
    csv.writer(text).writerows([("of", "quantity", "value", "unit"), *rows])
    with atomic_path(path) as temporary:
        temporary.write_text(text.getvalue(), encoding="utf-8", newline="")
