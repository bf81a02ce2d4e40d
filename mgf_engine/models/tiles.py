# SPDX-License-Identifier: GPL-3.0-or-later
"""3D Tiles 1.1 of one building: its levels of detail, the coarsest first, each replaced by the next finer one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mgf_engine import __version__
from mgf_engine.models.place import Array

FILE = "tileset.json"


def make_tileset(files: Sequence[str], errors: Sequence[float], points: Array, place: Array | None) -> dict[str, Any]:
    """Make the contents of ``tileset.json``.

    Args:
        files: names of the GLB files, the finest first; their axes are glTF's, y up.
        errors: how far each lies from the full mesh in metres, as long as ``files``.
        points: vertices of the full mesh, local frame, [N, 3].
        place: local frame -> geocentric coordinates [4, 4]; None leaves the building at the centre of the Earth.
    """
    low, high = points.min(0), points.max(0)
    half = np.maximum(0.5 * (high - low), 1e-3)
    box = [*(0.5 * (low + high)).tolist(), *np.diag(half).ravel().tolist()]
    growing = np.maximum.accumulate([0.0, *errors[1:]]).tolist()  # a finer tile must not claim a larger error
    tile: dict[str, Any] = {}
    for name, error in zip(files, growing, strict=True):
        finer = {"children": [tile]} if tile else {}
        tile = {"boundingVolume": {"box": box}, "geometricError": error, "refine": "REPLACE", "content": {"uri": name},
                **finer}  # fmt: skip
    if place is not None:
        tile["transform"] = place.T.ravel().tolist()  # column by column
    return {
        "asset": {"version": "1.1", "generator": f"mgf {__version__}"},
        "geometricError": float(2 * np.linalg.norm(half)),
        "root": tile,
    }
