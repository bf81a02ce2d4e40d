# SPDX-License-Identifier: GPL-3.0-or-later
"""Read footprints of buildings from map files: GeoJSON, GeoPackage, Shapefile and CityJSON."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from mgf_engine.errors import BadInput, reason

#: The packages that maps and many jobs need.
TOWN = "pip install 'mgf-engine[town]'"
_NAMES = ("id", "gml_id", "building_id", "osm_id", "identifier", "name")
_DEVICES = {"CON", "PRN", "AUX", "NUL", *(f"{port}{k}" for port in ("COM", "LPT") for k in range(1, 10))}  # of Windows
_LARGEST_JSON = 512 << 20  # bytes


@dataclass(frozen=True)
class Footprints:
    """The buildings of a map.

    Attributes:
        ids: unique, fit for names of folders.
        polygons: shapely polygons or multipolygons [N], coordinates of the file.
        crs: coordinate reference system that the file names; None where it names none.
        passed_over: number of entries that are no areas.
        file: where they came from, for messages.
    """

    ids: tuple[str, ...]
    polygons: NDArray[np.object_]
    crs: str | None
    passed_over: int
    file: Path


def read_footprints(path: Path, layer: str = "") -> Footprints:
    """Read a map of footprints.

    Args:
        layer: of a GeoPackage with several; the first with areas when empty.

    Raises:
        BadInput: the file is missing, of another kind, damaged, or holds no area; or a package is not installed.
    """
    if not path.is_file():
        raise BadInput(f"There are no footprints '{path}'; give a GeoJSON, GeoPackage, Shapefile or CityJSON file.")
    data = _json(path) if path.suffix.lower() in (".json", ".geojson") else None
    if data is not None and data.get("type") == "CityJSON":
        from mgf_engine.town.cityjson import read_cityjson

        names, shapes, crs = read_cityjson(data, path)
    else:
        names, shapes, crs = _read_with_gdal(path, layer)
        if data is not None and "crs" not in data:
            crs = None  # GDAL says WGS 84 of every such file, also of those in metres
    return _checked(names, shapes, crs, path)


def _json(path: Path) -> dict[str, Any]:
    """Read a JSON file that holds an object.

    Raises:
        BadInput: it is too large, damaged, or holds something else.
    """
    if path.stat().st_size > _LARGEST_JSON:
        raise BadInput(f"'{path}' is larger than {_LARGEST_JSON >> 20} MB; save the footprints as GeoPackage.")
    try:
        data = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError) as error:
        raise BadInput(f"The footprints '{path}' cannot be read ({reason(error)}); export them again.") from error
    if not isinstance(data, dict):
        raise BadInput(f"'{path}' is JSON, but neither GeoJSON nor CityJSON; export the footprints again.")
    return data


def _read_with_gdal(path: Path, layer: str) -> tuple[list[str], list[Any], str | None]:
    """Read names, shapes and CRS with GDAL."""
    try:
        import pyogrio
    except ImportError as error:
        raise BadInput(f"Footprints need the package pyogrio, which is not installed; get it by {TOWN}.") from error
    try:
        layers = pyogrio.list_layers(path)
        names = [str(name) for name, _ in layers]
        if layer and layer not in names:
            raise BadInput(f"'{path}' has no layer '{layer}' (it has {', '.join(names[:5])}); give one of these.")
        name = layer or _layer_of_areas(layers)
        meta, fids, wkb, columns = pyogrio.raw.read(path, layer=name, return_fids=True, force_2d=True)
    except (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError, ValueError) as error:
        raise BadInput(
            f"The footprints '{path}' cannot be read ({reason(error)}); give GeoJSON, GeoPackage, Shapefile "
            "or CityJSON."
        ) from error
    shapes = list(shapely.from_wkb(wkb, on_invalid="ignore")) if wkb is not None else []
    fields = [str(field).lower() for field in meta["fields"]]
    named = next((columns[fields.index(key)] for key in _NAMES if key in fields), None)
    ids = [_name(fid if named is None else named[i]) or str(fid) for i, fid in enumerate(fids)]
    return ids, shapes, meta["crs"]


def _name(value: Any) -> str:
    """Return a field of a map as a name; empty where nobody filled it in. Whole numbers beside empty fields come as
    real ones."""
    if value is None or value != value:
        return ""
    return str(int(value)) if isinstance(value, float) and value.is_integer() else str(value).strip()


def _layer_of_areas(layers: Any) -> str | None:
    """Return the first layer whose shapes are areas, or the first at all."""
    names = [str(name) for name, kind in layers if "Polygon" in str(kind)]
    return (names or [str(name) for name, _ in layers] or [None])[0]  # type: ignore[list-item]


def _checked(names: list[str], shapes: list[Any], crs: str | None, path: Path) -> Footprints:
    """Keep areas only, made valid, with names that folders can have."""
    ids, polygons, taken = list[str](), list[Any](), set[str]()
    for name, shape in zip(names, shapes, strict=True):
        if shape is None or shape.is_empty:
            continue
        sound = shape if shape.is_valid else shapely.make_valid(shape)
        areas = [part for part in getattr(sound, "geoms", [sound]) if part.geom_type == "Polygon" and part.area > 0]
        if not areas or not np.isfinite(sound.bounds).all():
            continue
        plain = plain_id(name) or str(len(ids) + 1)
        unique, count = plain, 1
        while unique.casefold() in taken:
            count += 1
            unique = f"{plain}_{count}"
        taken.add(unique.casefold())
        ids.append(unique)
        polygons.append(areas[0] if len(areas) == 1 else shapely.MultiPolygon(areas))
    if not ids:
        raise BadInput(f"'{path}' holds no areas; give the file with the outlines of the buildings.")
    found = np.empty(len(polygons), object)
    found[:] = polygons
    return Footprints(tuple(ids), found, crs, len(names) - len(ids), path)


def plain_id(text: str) -> str:
    """Return a name that folders of every system can have."""
    plain = re.sub(r"[^A-Za-z0-9_.-]+", "_", text).strip("._")[:60].rstrip("._")
    return plain if plain.partition(".")[0].upper() not in _DEVICES else "_" + plain
