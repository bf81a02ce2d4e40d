# SPDX-License-Identifier: GPL-3.0-or-later
"""A mesh from four sides, coloured by how far it lies outside (red) or inside (blue) of a laser scan."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.evaluation.error_map import SIDES, SIZE, subdivided
from mgf_engine.evaluation.pictures import circle_views
from mgf_engine.evaluation.scan import ScanDistances
from mgf_engine.evaluation.surfaces import Surface
from mgf_engine.geometry.rasterize import shaded
from mgf_engine.images import write_picture
from mgf_engine.model.mesh import Mesh

NEIGHBOURS = 6  # scan points that a vertex takes its colour from
BARE = np.array([170.0, 170, 170])  # where there are none


def write_scan_picture(path: Path, mesh: Surface, found: ScanDistances, reach: float) -> None:
    """Write the picture; full colour at the 95th percentile of the distances.

    Raises:
        BadInput: it cannot be written.
    """
    limit = max(float(np.percentile(np.abs(found.outside), 95)), 1e-9)
    fine = subdivided(mesh, reach)
    painted = Mesh(fine.vertices, fine.faces.astype(np.int32), _colors(fine.vertices, found, limit, reach))
    views = circle_views(painted, np.array([0.0, 0.0, 1.0]), np.array([-0.6, -1.0, 0.0]), SIDES, SIZE)
    row = np.hstack([shaded(painted, view, color=True) for view in views])
    write_picture(path, np.vstack([row, _legend(limit, row.shape[1])]))


def _colors(vertices: NDArray[np.float64], found: ScanDistances, limit: float, reach: float) -> NDArray[np.uint8]:
    """Colour of each vertex by the mean distance of the scan points around it, RGB uint8 [N, 3]."""
    from scipy.spatial import cKDTree

    distance, index = cKDTree(found.points).query(vertices, k=NEIGHBOURS, distance_upper_bound=reach)
    known = np.isfinite(distance)
    values = np.where(known, np.append(found.outside, 0.0)[index], 0.0)
    mean = values.sum(1) / np.maximum(known.sum(1), 1)
    return np.where(known.any(1)[:, None], ramp(mean / limit), BARE).round().astype(np.uint8)


def ramp(share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Blue at -1, white at 0, red at 1, [..., 3]."""
    share = np.clip(share, -1, 1)[..., None]
    white, red, blue = np.full(3, 245.0), np.array([190.0, 20, 40]), np.array([30.0, 70, 190])
    return np.where(share > 0, white + share * (red - white), white - share * (blue - white))


def _legend(limit: float, width: int) -> NDArray[np.uint8]:
    strip = np.full((48, width, 3), 255, np.uint8)
    strip[12:36, 20:320] = ramp(np.linspace(-1, 1, 300)).round().astype(np.uint8)
    text = f"{-limit:.3g} (mesh inside the scan) to {limit:.3g} (outside); grey: no scan point near"
    cv2.putText(strip, text, (336, 31), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (40, 40, 40), 1, cv2.LINE_AA)
    return strip
