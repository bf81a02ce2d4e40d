# SPDX-License-Identifier: GPL-3.0-or-later
"""Error map of a mesh against a laser scan, from four sides: outside red, inside blue."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.evaluation.error_map import SIDES, SIZE, subdivided
from mgf_engine.evaluation.pictures import circle_views
from mgf_engine.evaluation.scan import ScanDistances
from mgf_engine.evaluation.surfaces import Surface
from mgf_engine.files.images import write_picture
from mgf_engine.geometry.rasterize import shaded
from mgf_engine.model.mesh import Mesh

NEIGHBOURS = 6  # scan points that a vertex takes its colour from
BARE = np.array([170.0, 170, 170])  # where there are none
COLUMNS, MARGIN, _SIDE = 2, 12, 24  # sides beside each other; pixels around the building, and beside the legend


def write_scan_picture(path: Path, mesh: Surface, found: ScanDistances, reach: float, unit: str = "") -> None:
    """Write the picture; full colour at the 95th percentile of the distances.

    Args:
        path: of the PNG.
        mesh: in the coordinates of the scan.
        found: distances of the scan's points.
        reach: distance within which scan points colour a vertex.
        unit: of the mesh's coordinates, where it is known.

    Raises:
        BadInput: it cannot be written.
    """
    limit = max(float(np.percentile(np.abs(found.outside), 95)), 1e-9)
    fine = subdivided(mesh, reach)
    painted = Mesh(fine.vertices, fine.faces.astype(np.int32), _colors(fine.vertices, found, limit, reach))
    views = circle_views(painted, np.array([0.0, 0.0, 1.0]), np.array([-0.6, -1.0, 0.0]), SIDES, SIZE)
    sides = cropped([shaded(painted, view, color=True) for view in views])
    rows = [np.hstack(sides[k : k + COLUMNS]) for k in range(0, SIDES, COLUMNS)]
    write_picture(path, np.vstack([*rows, _legend(limit, rows[0].shape[1], unit)]))


def cropped(pictures: list[NDArray[np.uint8]]) -> list[NDArray[np.uint8]]:
    """Return the part of all pictures that is not white in one of them, with a margin: all keep one scale."""
    drawn = np.any([picture.min(-1) < 250 for picture in pictures], axis=0)
    if not drawn.any():
        return pictures
    v, u = np.flatnonzero(drawn.any(1)), np.flatnonzero(drawn.any(0))
    top, left = max(0, v[0] - MARGIN), max(0, u[0] - MARGIN)
    return [picture[top : v[-1] + MARGIN, left : u[-1] + MARGIN] for picture in pictures]


def _colors(vertices: NDArray[np.float64], found: ScanDistances, limit: float, reach: float) -> NDArray[np.uint8]:
    """Return the colour of each vertex by the mean distance of the scan points around it, RGB uint8 [N, 3]."""
    from scipy.spatial import cKDTree

    distance, index = cKDTree(found.points).query(vertices, k=NEIGHBOURS, distance_upper_bound=reach)
    known = np.isfinite(distance)
    values = np.where(known, np.append(found.outside, 0.0)[index], 0.0)
    mean = values.sum(1) / np.maximum(known.sum(1), 1)
    return np.where(known.any(1)[:, None], ramp(mean / limit), BARE).round().astype(np.uint8)


def ramp(share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Colour values: blue at -1, white at 0, red at 1, [..., 3]."""
    share = np.clip(share, -1, 1)[..., None]
    white, red, blue = np.full(3, 245.0), np.array([190.0, 20, 40]), np.array([30.0, 70, 190])
    return np.where(share > 0, white + share * (red - white), white - share * (blue - white))


def _legend(limit: float, width: int, unit: str) -> NDArray[np.uint8]:
    """Return the colours with their distances, and what they mean."""
    strip = np.full((92, width, 3), 255, np.uint8)
    long = width - 2 * _SIDE
    strip[10:34, _SIDE : _SIDE + long] = ramp(np.linspace(-1, 1, long)).round().astype(np.uint8)
    for share in (-1.0, -0.5, 0.0, 0.5, 1.0):
        _write(strip, f"{share * limit:+.3g}{unit}" if share else "0", _SIDE + round((share + 1) / 2 * (long - 1)), 52)
    _write(strip, "blue: mesh inside the scan, red: outside, grey: no scan point near", width // 2, 80)
    return strip


def _write(picture: NDArray[np.uint8], text: str, middle: int, line: int) -> None:
    """Write text about a column, within the picture where it fits, over the line of that row."""
    size = min(0.55, 0.55 * picture.shape[1] / (10.0 * len(text)))
    (wide, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 1)
    left = min(max(4, middle - wide // 2), max(4, picture.shape[1] - wide - 4))
    cv2.putText(picture, text, (left, line), cv2.FONT_HERSHEY_SIMPLEX, size, (40, 40, 40), 1, cv2.LINE_AA)
