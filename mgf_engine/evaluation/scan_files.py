# SPDX-License-Identifier: GPL-3.0-or-later
"""Points of a laser scan from LAS, LAZ, E57 or PLY."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mgf_engine.errors import BadInput, reason
from mgf_engine.evaluation.surfaces import Points
from mgf_engine.system.machine import is_installed

MAX_POINTS = 10_000_000  # points kept, evenly over the file
NEEDED = {".las": ("laspy",), ".laz": ("laspy", "lazrs"), ".e57": ("pye57",), ".ply": ()}


def read_scan(path: Path) -> Points:
    """Read the points of a scan, [N, 3], in the file's coordinates.

    Raises:
        BadInput: the file is missing, damaged, of another kind, or needs a package that is not installed.
    """
    if not path.is_file():
        raise BadInput(f"There is no scan '{path}'; give the path of a LAS, LAZ, E57 or PLY file.")
    kind = path.suffix.lower()
    if kind not in NEEDED:
        raise BadInput(f"The scan '{path}' is of no kind that is read; give a LAS, LAZ, E57 or PLY file.")
    missing = [name for name in NEEDED[kind] if not is_installed(name)]
    if missing:
        raise BadInput(
            f"Scans of this kind need {', '.join(missing)}; install with: pip install 'mgf-engine[models]', in the "
            "engine's environment."
        )
    try:
        points = {".e57": _read_e57, ".ply": _read_ply}.get(kind, _read_las)(path)
    except Exception as error:  # the readers raise whatever their parsers raise
        raise BadInput(f"Cannot read the scan '{path}' ({reason(error)}); export it again.") from error
    points = points[np.isfinite(points).all(1)]
    if len(points) < 100:
        raise BadInput(f"The scan '{path}' has {len(points)} points; a comparison needs a hundred at least.")
    return points[:: -(-len(points) // MAX_POINTS)]


def _read_las(path: Path) -> Points:
    import laspy

    return np.asarray(laspy.read(str(path)).xyz, np.float64)


def _read_e57(path: Path) -> Points:
    import pye57

    file: Any = pye57.E57(str(path))
    scans = [file.read_scan(k, ignore_missing_fields=True) for k in range(file.scan_count)]
    return np.concatenate([np.stack([scan[f"cartesian{axis}"] for axis in "XYZ"], 1) for scan in scans])


def _read_ply(path: Path) -> Points:
    import trimesh

    loaded: Any = trimesh.load(path, file_type="ply", process=False)
    return np.asarray(loaded.vertices, np.float64).reshape(-1, 3)
