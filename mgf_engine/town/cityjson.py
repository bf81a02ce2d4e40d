# SPDX-License-Identifier: GPL-3.0-or-later
"""Footprints out of CityJSON (https://www.cityjson.org/specs), versions 1 and 2; GDAL has no reader of it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from mgf_engine.errors import BadInput

_DEPTH = {"MultiSurface": 0, "CompositeSurface": 0, "Solid": 1, "MultiSolid": 2, "CompositeSolid": 2}


def read_cityjson(data: dict[str, Any], path: Path) -> tuple[list[str], list[Any], str | None]:
    """Read ids, shapely polygons and CRS of the buildings; parts of a building count as that building.

    Raises:
        BadInput: the file does not keep to the format.
    """
    try:
        vertices = np.array(data["vertices"], np.float64).reshape(-1, 3)
        if "transform" in data:
            vertices = vertices * data["transform"]["scale"] + data["transform"]["translate"]
        system = str(data.get("metadata", {}).get("referenceSystem", ""))
        rings: dict[str, list[Any]] = {}
        for name, item in data["CityObjects"].items():
            if item["type"] in ("Building", "BuildingPart"):
                owner = item["parents"][0] if item["type"] == "BuildingPart" and item.get("parents") else name
                rings.setdefault(owner, []).extend(_areas(item, vertices))
    except (KeyError, ValueError, TypeError, IndexError, AttributeError) as error:
        raise BadInput(f"'{path}' is damaged CityJSON ({error!r}); export it again.") from error
    code = re.search(r"EPSG[/:](?:[\d.]*[/:])?(\d+)$", system)
    return list(rings), [shapely.union_all(areas) for areas in rings.values()], f"EPSG:{code[1]}" if code else None


def _areas(item: dict[str, Any], vertices: NDArray[np.float64]) -> list[Any]:
    """Return the ground surfaces of an object from above, or all its surfaces where none is called so."""
    ground, other = list[Any](), list[Any]()
    for geometry in item.get("geometry", []):
        depth = _DEPTH.get(geometry["type"])
        if depth is None:
            continue
        semantics = geometry.get("semantics") or {}
        kinds = [surface["type"] for surface in semantics.get("surfaces", [])]
        values = list(_flat(semantics.get("values") or [], depth))
        for number, surface in enumerate(_flat(geometry["boundaries"], depth)):
            outline, *holes = [vertices[ring][:, :2] for ring in surface]
            area = shapely.make_valid(shapely.Polygon(outline, holes)) if len(outline) > 2 else None
            if area is None or area.area < 1e-9:  # a wall
                continue
            value = values[number] if number < len(values) else None
            (ground if value is not None and kinds[value] == "GroundSurface" else other).append(area)
    return ground or other


def _flat(nested: Any, depth: int) -> Iterator[Any]:
    """Yield what lies so deep in a list of lists."""
    if depth == 0:
        yield from nested
    else:
        for inner in nested:
            yield from _flat(inner or [], depth - 1)
