# SPDX-License-Identifier: GPL-3.0-or-later
"""Write and read a starting surface: the field stage leaves it to the mesh stage."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mgf_engine.files.atomic import atomic_path
from mgf_engine.files.safe_npz import read_arrays
from mgf_engine.model.mesh import Mesh
from mgf_engine.start.surface import StartSurface

FILE = "start.npz"
#: Arrays of the file; "sure" is the confidence of the faces.
_NAMES = ("vertices", "faces", "sure", "dense", "seen", "pixel", "planes")


def write_start(surface: StartSurface, path: Path) -> None:
    """Write a starting surface; a stop half way leaves no file."""
    mesh = surface.mesh
    pixel = np.float64(surface.pixel)
    values = mesh.vertices, mesh.faces, surface.confidence, surface.dense, surface.seen, pixel, surface.planes
    with atomic_path(path) as part:
        np.savez(part, **dict(zip(_NAMES, values, strict=True)))  # type: ignore[arg-type]


def read_start(path: Path) -> StartSurface | None:
    """Read a starting surface; None where there is none, or none that can be used."""
    if not path.exists():
        return None
    try:
        data = read_arrays(path)
        planes = data.get("planes", np.zeros((0, 4)))  # files of earlier versions have none
        vertices, faces, confidence, dense, seen, pixel = (data[name] for name in _NAMES[:-1])
    except (OSError, ValueError, KeyError):
        return None
    if len(faces) == 0 or faces.min() < 0 or faces.max() >= len(vertices) or len(confidence) != len(faces):
        return None
    if planes.ndim != 2 or planes.shape[1] != 4:
        return None
    mesh = Mesh(vertices, faces, np.zeros((len(vertices), 3), np.uint8))
    return StartSurface(mesh, confidence, dense, seen, float(pixel), planes)
