# SPDX-License-Identifier: GPL-3.0-or-later
"""The georeference of a job: how its scene frame lies in a local metric frame and in a coordinate reference system.

Frames. *Scene frame*: the coordinates of the COLMAP model, as in ``mesh.ply`` and ``deliver.json``. *Local frame*: x
east, y north, z up, with its origin near the building, small enough for float32. *World*: the coordinates of ``crs``
(easting, northing, height, in this order), which are the local ones plus ``offset``, nothing else.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput, reason
from mgf_engine.files.atomic import write_json

FILE = "georef.json"
FORMAT = 1
METRE, SCENE_UNITS = "metre", "scene units"
UNITS = (METRE, SCENE_UNITS)
#: How a georeference was found; ``none`` is a job without one.
METHODS = ("none", "gps", "control", "scale_bars", "up")
_UNITS_NAME = {METRE: "m", SCENE_UNITS: "units"}


def _identity() -> NDArray[np.float64]:
    return np.eye(4)


@dataclass(frozen=True)
class Georeference:
    """A similarity from the scene frame to the local frame, and what the local frame is.

    Attributes:
        to_local: float64 [4, 4], scene frame -> local frame; the upper left is one scale times a rotation.
        offset: easting, northing, height that are added to local coordinates.
        crs: as pyproj reads it, such as ``EPSG:25832``; None for a local frame.
        unit: of the local frame, one of :data:`UNITS`.
        up_known: z of the local frame is up.
        north_known: y of the local frame is north: of the CRS's grid, or true north where there is no CRS.
        method: one of :data:`METHODS`.
        heights: what heights are, such as ``ellipsoidal (WGS 84)``; empty where nobody knows.
        origin: latitude and longitude in degrees and height in metres (WGS 84) of the local origin; None if unknown.
        accuracy: root mean square residuals in the local unit by axis and kind, such as ``control_x``.
    """

    to_local: NDArray[np.float64] = field(default_factory=_identity)
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    crs: str | None = None
    unit: str = SCENE_UNITS
    up_known: bool = False
    north_known: bool = False
    method: str = "none"
    heights: str = ""
    origin: tuple[float, float, float] | None = None
    accuracy: Mapping[str, float] = field(default_factory=dict)

    @property
    def scale(self) -> float:
        """Local units per unit of the scene frame."""
        return float(np.cbrt(np.linalg.det(self.to_local[:3, :3])))

    @property
    def rotation(self) -> NDArray[np.float64]:
        """Axes of the scene frame -> axes of the local frame, [3, 3]."""
        return np.asarray(self.to_local[:3, :3] / self.scale)

    @property
    def up(self) -> NDArray[np.float64] | None:
        """Unit vector upwards in the scene frame, [3]; None where unknown."""
        return self.rotation[2] if self.up_known else None

    @property
    def north(self) -> NDArray[np.float64] | None:
        """Unit vector northwards in the scene frame, [3]; None where unknown."""
        return self.rotation[1] if self.north_known else None

    @property
    def metric(self) -> bool:
        """Whether lengths are metres."""
        return self.unit == METRE

    @property
    def unit_name(self) -> str:
        """The unit as it stands behind a number."""
        return _UNITS_NAME[self.unit]

    def local(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert scene frame to local frame; points [..., 3]."""
        return points @ self.to_local[:3, :3].T + self.to_local[:3, 3]

    def scene(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert local frame to scene frame; points [..., 3]."""
        return (points - self.to_local[:3, 3]) @ np.linalg.inv(self.to_local[:3, :3]).T

    def world(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert scene frame to coordinates of the CRS, float64; points [..., 3]."""
        return self.local(points) + np.array(self.offset)

    def from_world(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert coordinates of the CRS to scene frame; points [..., 3]."""
        return self.scene(points - np.array(self.offset))


def write_georeference(georeference: Georeference, folder: Path) -> None:
    """Write ``georef.json`` into a job folder."""
    values = {**georeference.__dict__, "to_local": georeference.to_local.tolist()}
    values["accuracy"] = dict(georeference.accuracy)
    write_json(folder / FILE, {"format": FORMAT, **values})


def read_georeference(folder: Path) -> Georeference:
    """Read the georeference in a job folder; the scene's own frame and units where it holds none.

    Raises:
        BadInput: the file is damaged or of a newer version.
    """
    path = folder / FILE
    if not path.exists():
        return Georeference()
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if data.pop("format") != FORMAT:
            raise ValueError("it was written by another version of MGF")
        return _checked(data)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise BadInput(
            f"The georeference '{path}' cannot be used ({reason(error)}); run 'mgf georef' again."
        ) from error


def _checked(data: dict[str, Any]) -> Georeference:
    """Read the georeference of a file's contents; ValueError, KeyError or TypeError where they are none."""
    matrix = np.array(data["to_local"], np.float64)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all() or matrix[3].tolist() != [0, 0, 0, 1]:
        raise ValueError("to_local is no similarity")
    square = matrix[:3, :3] @ matrix[:3, :3].T
    scale = float(np.trace(square)) / 3
    if not np.linalg.det(matrix[:3, :3]) > 0 or np.abs(square - scale * np.eye(3)).max() > 1e-6 * scale:
        raise ValueError("to_local is no similarity")
    if data["unit"] not in UNITS or data["method"] not in METHODS:
        raise ValueError("its unit or method is unknown")
    if not isinstance(data["crs"], str | None) or not isinstance(data["heights"], str):
        raise TypeError("crs or heights is no text")
    return Georeference(
        matrix, _three(data["offset"]), data["crs"], data["unit"], bool(data["up_known"]), bool(data["north_known"]),
        data["method"], data["heights"], None if data["origin"] is None else _three(data["origin"]),
        {str(name): float(value) for name, value in data["accuracy"].items()},
    )  # fmt: skip


def _three(values: Any) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    if not all(map(math.isfinite, (x, y, z))):
        raise ValueError("a number is not finite")
    return x, y, z
