# SPDX-License-Identifier: GPL-3.0-or-later
"""The solid as CityJSON 2.0: one Building with a Solid whose surfaces say what they are.

Specification: https://www.cityjson.org/specs/2.0.1/.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from mgf_engine.drawings.model import Survey
from mgf_engine.models.solid.model import DOOR, GROUND, ROOF, WALL, WINDOW, Solid, SolidFace

FILE = "building.city.json"
MILLIMETRE = 0.001
SURFACES = {ROOF: "RoofSurface", WALL: "WallSurface", GROUND: "GroundSurface", WINDOW: "Window", DOOR: "Door"}


def make_cityjson(solid: Solid, survey: Survey, name: str, detailed: Solid | None = None) -> dict[str, Any]:
    """Make the contents of the file; coordinates are those of the CRS, or local where there is none.

    Args:
        solid: local frame.
        survey: tells the CRS and where the local frame lies.
        name: of the building, its identifier in the file.
        detailed: the same with windows and doors, whose vertices begin with those of the solid: a second geometry.
    """
    world = survey.world((detailed or solid).vertices)
    low = np.floor(world.min(0))
    step = MILLIMETRE if survey.georeference.metric else 1e-6 * float(np.ptp(world, axis=0).max())
    whole = np.rint((world - low) / step).astype(np.int64)
    top = float(world[:, 2].max() - world[:, 2].min())
    attributes: dict[str, Any] = {
        "measuredHeight": round(top, 3), "volume": round(solid.volume, 3), "groundFrom": solid.ground_from,
        "detail": round(solid.detail, 4), "unseen": solid.unseen,
    }  # fmt: skip
    if solid.deviation is not None:
        attributes["deviationRMS"] = round(solid.deviation.rms, 4)
        attributes["deviation90"] = round(solid.deviation.p90, 4)
    metadata: dict[str, Any] = {"geographicalExtent": [*_round(world.min(0)), *_round(world.max(0))], "title": name}
    system = reference_system(survey.georeference.crs)
    if system is not None:
        metadata["referenceSystem"] = system
    geometries = [_geometry(one) for one in (solid, detailed) if one is not None]
    return {
        "type": "CityJSON", "version": "2.0", "transform": {"scale": [step] * 3, "translate": low.tolist()},
        "metadata": metadata,
        "CityObjects": {name: {"type": "Building", "attributes": attributes, "geometry": geometries}},
        "vertices": whole.tolist(),
    }  # fmt: skip


def _geometry(solid: Solid) -> dict[str, Any]:
    """Return a solid as CityJSON's geometry, each face with its semantic surface."""
    surfaces = [_surface(solid, face) for face in solid.faces]
    for number, face in enumerate(solid.faces):
        if face.wall >= 0:
            surfaces[number]["parent"] = face.wall
            surfaces[face.wall].setdefault("children", []).append(number)
    return {
        "type": "Solid", "lod": str(solid.level),
        "boundaries": [[[list(ring) for ring in face.rings] for face in solid.faces]],
        "semantics": {"surfaces": surfaces, "values": [list(range(len(surfaces)))]},
    }  # fmt: skip


def reference_system(crs: str | None) -> str | None:
    """Return the CRS as a URI of OGC, or None where it is no code of EPSG."""
    found = re.fullmatch(r"(?i)EPSG:(\d+)", crs or "")
    return f"https://www.opengis.net/def/crs/EPSG/0/{found[1]}" if found else None


def _surface(solid: Solid, face: SolidFace) -> dict[str, Any]:
    surface: dict[str, Any] = {"type": SURFACES[face.kind], "area": round(solid.area(face), 3)}
    normal = solid.normal(face)
    if face.kind == ROOF:
        surface["slope"] = round(float(np.degrees(np.arccos(np.clip(normal[2], -1, 1)))), 2)
    if face.kind != GROUND and np.hypot(*normal[:2]) > 0.02:
        surface["azimuth"] = round(float(np.degrees(np.arctan2(normal[0], normal[1])) % 360), 2)
    return surface


def _round(values: Any) -> list[float]:
    return [round(float(value), 3) for value in values]
