# SPDX-License-Identifier: GPL-3.0-or-later
"""Error maps: mesh and truth from four sides, coloured by their distance to each other."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.evaluation.pictures import circle_views
from mgf_engine.evaluation.surfaces import Surface
from mgf_engine.files.images import write_picture
from mgf_engine.geometry.rasterize import shaded
from mgf_engine.model.mesh import Mesh

Picture = NDArray[np.uint8]

SIDES = 4
SIZE = (800, 600)
_FINE = 4  # the truth's long triangles are cut until no edge is longer than this many times the largest threshold


def write_error_map(path: Path, mesh: Surface, truth: Surface, threshold: float) -> None:
    """Write a picture with two rows: the mesh coloured by distance to the truth, the truth by distance to the mesh.

    Grey blue is right, yellow one threshold away, dark red four thresholds and more.

    Args:
        path: of the PNG.
        mesh: in the coordinates of the truth.
        truth: the true surface.
        threshold: a distance that counts as right, units of the meshes.

    Raises:
        BadInput: the picture cannot be written.
    """
    views = circle_views(_as_mesh(truth), np.array([0.0, 0.0, 1.0]), np.array([-0.6, -1.0, 0.0]), SIDES, SIZE)
    rows = []
    for shown, other in ((mesh, truth), (subdivided(truth, _FINE * threshold), mesh)):
        painted = Mesh(shown.vertices, shown.faces.astype(np.int32), colors(other.distances(shown.vertices), threshold))
        rows.append(np.hstack([shaded(painted, view, color=True) for view in views]))
    write_picture(path, np.vstack([*rows, _legend(threshold, rows[0].shape[1])]))


def colors(distances: NDArray[np.float64], threshold: float) -> Picture:
    """Return RGB uint8 [N, 3] of distances [N]: each stop is twice as far as the one before it."""
    stops = threshold * np.array([0.25, 0.5, 1.0, 2.0, 4.0])
    table = np.array([[150, 165, 190], [150, 200, 170], [250, 220, 90], [235, 110, 40], [140, 10, 20]], float)
    return np.column_stack([np.interp(distances, stops, table[:, k]) for k in range(3)]).round().astype(np.uint8)


def subdivided(surface: Surface, longest: float) -> Surface:
    """Return the same surface with no edge longer than ``longest``, so that colours per vertex show what lies between.

    At most about two million faces: ``longest`` grows where it would take more.
    """
    from trimesh.remesh import subdivide_to_size

    longest = max(longest, float(np.sqrt(surface.areas.sum() / 1e6)))
    vertices, faces = subdivide_to_size(surface.vertices, surface.faces, longest, max_iter=30)
    return Surface(vertices, faces)


def _as_mesh(surface: Surface) -> Mesh:
    return Mesh(surface.vertices, surface.faces.astype(np.int32), np.zeros((len(surface.vertices), 3), np.uint8))


def _legend(threshold: float, width: int) -> Picture:
    """Return a strip with the colours and what they stand for, RGB [48, width, 3]."""
    strip = np.full((48, width, 3), 255, np.uint8)
    for place, factor in enumerate((0.25, 0.5, 1.0, 2.0, 4.0)):
        x, color = 20 + 150 * place, colors(np.array([factor * threshold]), threshold)[0]
        cv2.rectangle(strip, (x, 12), (x + 36, 36), color.tolist(), -1)
        cv2.putText(
            strip, f"{factor * threshold:g}", (x + 44, 31), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (40, 40, 40), 1, cv2.LINE_AA
        )
    text = "above: mesh, by distance to the truth; below: truth, by distance to the mesh"
    cv2.putText(strip, text, (800, 31), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (40, 40, 40), 1, cv2.LINE_AA)
    return strip
