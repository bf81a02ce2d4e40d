# SPDX-License-Identifier: GPL-3.0-or-later
"""A survey of the painted house: control and check points on its corners, and their marks in the photos."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.synthetic.house import OFFSET, House, ring_view


def write_survey(folder: Path, house: House, photos: int = 14) -> NDArray[np.float64]:
    """Write ``points.csv`` and ``marks.csv`` (every second photo); returns the true similarity [4, 4]."""
    origin, angle = np.array([691_234.0, 5_334_876.0, 519.0]), np.radians(30.0)
    true = np.eye(4)
    true[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    true[:3, :3] *= 2.5
    true[:3, 3] = origin - true[:3, :3] @ OFFSET
    points, marks = ["name,east,north,height,accuracy,role"], ["name,photo,x,y"]
    for name, corner in zip(("P1", "P2", "P3", "P4", "P5", "C1", "C2"), (0, 1, 2, 7, 8, 9, 4), strict=True):
        at = house.mesh.vertices[corner]
        east, north, height = true[:3, :3] @ at + true[:3, 3]
        role = "check" if name[0] == "C" else "control"
        points.append(f"{name},{east:.5f},{north:.5f},{height:.5f},0.01,{role}")
        for view in (ring_view(k, photos) for k in range(0, photos, 2)):
            x, y = view.project(at[None])[0][0]
            marks.append(f"{name},{view.name},{x:.3f},{y:.3f}")
    (folder / "points.csv").write_text("\n".join(points))
    (folder / "marks.csv").write_text("\n".join(marks))
    return true
