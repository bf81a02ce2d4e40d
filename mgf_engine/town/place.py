# SPDX-License-Identifier: GPL-3.0-or-later
"""Place footprints in the scene's frame: by georeference, by point pairs, or by the scene's own axes."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from mgf_engine.errors import BadInput, reason
from mgf_engine.georef.crs import AUTO, normalise_crs, proj, stretches, utm_zone_number
from mgf_engine.georef.find import find_georeference
from mgf_engine.georef.fit_gps import MIN_GPS_POSITIONS
from mgf_engine.georef.gps import read_gps_position
from mgf_engine.georef.model import METRE, Georeference
from mgf_engine.georef.options import GeoreferenceOptions
from mgf_engine.georef.similarity import LINE, straightness, umeyama
from mgf_engine.model.scene import Scene
from mgf_engine.options.config import Config
from mgf_engine.scene.normalise import CAMERA_DISTANCE
from mgf_engine.town.footprints import Footprints

Array = NDArray[np.float64]
#: What ``--footprints-crs`` takes for coordinates of the scene itself.
SCENE_FRAME = "scene"
_WGS84 = "EPSG:4326"
_VIEWING = 25.0  # metres from a camera to what it looks at
_NEAR = 3000.0  # metres: a guess that lands so near the photos is worth saying
_USUAL = ("EPSG:3857", "EPSG:2154", "EPSG:28992", "EPSG:27700", "EPSG:2056", "EPSG:3035", "EPSG:31370", "EPSG:2180")
_PAIRS = ("east", "north", "height", "x", "y", "z")


@dataclass(frozen=True)
class PlacedFootprints:
    """Footprints in the local frame of a scene.

    Attributes:
        georeference: scene frame -> local frame (z up).
        polygons: shapely [N], local frame.
        metre: length of a metre in the local frame.
        crs: of the file, as it was understood; None for the scene's own frame.
        note: one sentence about how they were placed.
    """

    georeference: Georeference
    polygons: NDArray[np.object_]
    metre: float
    crs: str | None
    note: str


def local_points(scene: Scene, georeference: Georeference) -> Array:
    """Return the sparse points in the local frame, [P, 3]."""
    return georeference.local(scene.to_normalised.invert(scene.points))


def to_normalised(scene: Scene, georeference: Georeference, points: Array) -> Array:
    """Convert local frame to normalised frame; points [..., 3]."""
    return scene.to_normalised.apply(georeference.scene(points))


def place_footprints(
    footprints: Footprints,
    scene: Scene,
    config: Config,
    crs: str = "",
    pairs: Path | None = None,
    warn: Callable[[str], None] = lambda text: None,
) -> PlacedFootprints:
    """Bring footprints to the scene.

    Args:
        footprints: as their file has them.
        scene: cameras and sparse points.
        config: tells where the scene is: control points, CRS, or the GPS of its photos.
        crs: coordinate reference system of the file in the place of the one that it names; ``scene`` for coordinates
            of the scene frame.
        pairs: file of points known in both, see :func:`read_pairs`.
        warn: takes a sentence about what looks wrong.

    Raises:
        BadInput: nothing tells where the scene is, a CRS or the pairs cannot be used, or no footprint lies near it.
    """
    named = normalise_crs(crs) if crs and crs != SCENE_FRAME else footprints.crs
    if pairs is not None:
        placed = _by_pairs(footprints, read_pairs(pairs), named)
    elif crs != SCENE_FRAME and _located(scene, config):
        placed = _by_georeference(footprints, scene, config, named, warn)
    elif named is not None and crs != SCENE_FRAME:
        raise BadInput(
            f"The footprints are in {named}, and nothing tells where the photos are (no GPS, no control points); give "
            "--pairs FILE with three points known in both, or --footprints-crs scene for coordinates of the scene."
        )
    else:
        placed = _in_scene(footprints, scene, config, warn)
    _check_near(placed, footprints, local_points(scene, placed.georeference))
    return placed


def place_scene(
    scene: Scene, config: Config, warn: Callable[[str], None] = lambda text: None
) -> tuple[Georeference, float]:
    """Find the georeference of a scene without footprints, and the length of a metre in its local frame."""
    wanted = config if config.crs or not _located(scene, config) else replace(config, crs=AUTO)
    found = find_georeference(scene, wanted.algorithm(GeoreferenceOptions), warn).georeference
    return found, 1.0 if found.metric else usual_metre(scene, found.scale)


def usual_metre(scene: Scene, scale: float) -> float:
    """Return the length of a metre where nothing tells it: cameras are mostly some 25 metres from what they look at.

    Args:
        scale: local units per unit of the scene frame.
    """
    return CAMERA_DISTANCE / scene.to_normalised.scale * scale / _VIEWING


def _located(scene: Scene, config: Config) -> bool:
    """Tell whether control points or the GPS of four photos can tell where the scene is."""
    if config.control:
        return True
    if config.gps == "off":
        return False
    found = 0
    for view in scene.views:
        found += bool(view.photo) and read_gps_position(Path(view.photo)) is not None
        if found >= MIN_GPS_POSITIONS:
            return True
    return False


def _by_georeference(
    footprints: Footprints, scene: Scene, config: Config, named: str | None, warn: Callable[[str], None]
) -> PlacedFootprints:
    """Place footprints by control points or GPS of the photos; ``named``: CRS of the footprints, None if unknown."""
    crs = named or (_WGS84 if _degrees(footprints.polygons) else None)
    target = config.crs or (crs if crs is not None and _in_metres(crs) else AUTO)
    found = find_georeference(scene, replace(config.algorithm(GeoreferenceOptions), crs=target), warn).georeference
    polygons = footprints.polygons
    if crs is not None and crs != found.crs:
        polygons = transformed(polygons, crs, str(found.crs))
    note = f"Footprints in {crs}, photos placed by {found.method}." if crs else (
        f"The footprints name no coordinate reference system; they are taken as {found.crs}."
    )  # fmt: skip
    return PlacedFootprints(found, _shifted(polygons, found.offset), 1.0, crs or found.crs, note)


def _in_scene(footprints: Footprints, scene: Scene, config: Config, warn: Callable[[str], None]) -> PlacedFootprints:
    """Take footprints as x and y of the scene frame; the usual width of buildings tells the length of a metre."""
    found = find_georeference(scene, replace(config.algorithm(GeoreferenceOptions), crs=""), warn).georeference
    typical = float(np.median([np.sqrt(p.area) for p in footprints.polygons]))
    metre = 1.0 if found.metric else typical / 11.0
    note = (
        "Neither photos nor footprints say where they are; the footprints are taken as x and y of the scene with "
        f"z up, and a metre as {metre:.3g} of its units, for buildings are some 11 metres wide."
    )
    return PlacedFootprints(found, footprints.polygons, metre, None, note)


def _by_pairs(footprints: Footprints, pairs: Array, named: str | None) -> PlacedFootprints:
    """Place footprints by points known in map and scene, [N, 6] (see :func:`read_pairs`)."""
    world, scene = pairs[:, :3], pairs[:, 3:]
    offset = np.round(world.mean(0))
    matrix = umeyama(scene, world - offset)
    found = Georeference(
        matrix, (offset[0], offset[1], offset[2]), named, METRE, True, True, "control", "as the pairs have them"
    )
    off = np.linalg.norm(found.local(scene) - (world - offset), axis=1)
    note = f"Footprints placed by {len(pairs)} point pairs, which they fit to {off.max():.2f} m."
    return PlacedFootprints(found, _shifted(footprints.polygons, found.offset), 1.0, named, note)


def read_pairs(path: Path) -> Array:
    """Read points known in map and scene: a CSV with the columns east, north, height, x, y, z; float64 [N, 6].

    Raises:
        BadInput: the file cannot be read, has fewer than three points, or they lie on a line.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = [{str(k).strip().lower(): v for k, v in row.items()} for row in csv.DictReader(file)]
        pairs = np.array([[float(row[name]) for name in _PAIRS] for row in rows]).reshape(-1, 6)
        if not np.isfinite(pairs).all():
            raise ValueError("a number is not finite")
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise BadInput(
            f"The point pairs '{path}' cannot be read ({reason(error)}); give a CSV with the columns "
            f"{', '.join(_PAIRS)}."
        ) from error
    if len(pairs) < 3 or straightness(pairs[:, 3:]) < LINE or straightness(pairs[:, :3]) < LINE:
        raise BadInput(f"'{path}' needs three point pairs or more that do not lie on a line; add some.")
    return pairs


def transformed(polygons: NDArray[np.object_], source: str, target: str, swap: bool = False) -> NDArray[np.object_]:
    """Return polygons of one CRS in another; x before y in either.

    Args:
        polygons: [N] of shapely.
        source: CRS that they are in.
        target: CRS that is wanted.
        swap: exchange x and y of the source first.

    Raises:
        BadInput: there is no such CRS.
    """
    pyproj = proj()
    try:
        move = pyproj.Transformer.from_crs(source, target, always_xy=True)
    except pyproj.exceptions.CRSError as error:
        raise BadInput(f"There is no coordinate reference system '{source}'; give --footprints-crs.") from error

    def moved(points: Array) -> Array:
        x, y = (points[:, 1], points[:, 0]) if swap else (points[:, 0], points[:, 1])
        return np.stack(move.transform(x, y), 1)

    return np.asarray(shapely.transform(polygons, moved))


def _shifted(polygons: NDArray[np.object_], offset: tuple[float, float, float]) -> NDArray[np.object_]:
    return np.asarray(shapely.transform(polygons, lambda points: points - np.array(offset[:2])))


def _degrees(polygons: NDArray[np.object_]) -> bool:
    west, south, east, north = shapely.total_bounds(polygons)
    return bool(-180 <= west <= east <= 180 and -90 <= south <= north <= 90)


def _in_metres(crs: str) -> bool:
    """Tell whether lengths in a CRS are metres on the ground."""
    pyproj = proj()
    try:
        found = pyproj.CRS.from_user_input(crs)
    except pyproj.exceptions.CRSError as error:
        raise BadInput(f"There is no coordinate reference system '{crs}'; give --footprints-crs.") from error
    metres = {axis.unit_name for axis in found.axis_info[:2]} == {"metre"}
    return bool(found.is_projected and metres and not stretches(found))


def near_scene(polygons: NDArray[np.object_], points: Array, metre: float) -> NDArray[np.bool_]:
    """Tell which footprints lie where the sparse points are, bool [N]."""
    low, high = np.percentile(points[:, :2], (0.5, 99.5), axis=0)
    area = shapely.box(*(low - 5 * metre), *(high + 5 * metre))
    return np.asarray(shapely.intersects(polygons, area))


def _check_near(placed: PlacedFootprints, footprints: Footprints, points: Array) -> None:
    """Check that a footprint lies where the sparse points [P, 3] are.

    Raises:
        BadInput: none does; with the CRS under which they would.
    """
    finite = np.isfinite(shapely.bounds(placed.polygons)).all(1)
    if finite.any() and near_scene(placed.polygons[finite], points, placed.metre).any():
        return
    middle = np.median(points[:, :2], axis=0)
    nearest = shapely.distance(placed.polygons[finite], shapely.Point(*middle)).min() if finite.any() else np.inf
    guess = _guess(placed, footprints, middle)
    hint = (
        f"read as {guess} they would lie on them: give --footprints-crs with that"
        if guess
        else "check the file and its coordinate reference system (--footprints-crs)"
    )
    away = f"{nearest / placed.metre / 1000:.1f} km" if np.isfinite(nearest) else "nowhere on Earth"
    raise BadInput(
        f"None of the {len(footprints.ids)} footprints lies near the photos (the nearest: {away}, read as "
        f"{placed.crs or 'coordinates of the scene'}); {hint}."
    )


def _guess(placed: PlacedFootprints, footprints: Footprints, middle: Array) -> str:
    """Return the CRS under which the footprints would lie at the photos; empty where none is found."""
    if placed.georeference.crs is None or placed.georeference.origin is None:
        return ""
    here = str(placed.georeference.crs)
    zone = utm_zone_number(placed.georeference.origin[1])
    zones = [z for z in (zone - 1, zone, zone + 1) if 1 <= z <= 60]
    utm = [f"EPSG:{base + z}" for z in zones for base in (25800, 32600) if base != 25800 or 28 <= z <= 38]
    tried = [_WGS84, here, *utm, *(f"EPSG:{31460 + k}" for k in range(6, 10)), *_USUAL]
    centres = shapely.centroid(footprints.polygons)
    sample = np.asarray(centres[:: max(1, len(centres) // 50)])
    goal = middle + np.array(placed.georeference.offset[:2])
    for swap in (False, True):
        for crs in tried:
            places: Any = shapely.get_coordinates(transformed(sample, crs, here, swap))
            if np.isfinite(places).all() and np.linalg.norm(places - goal, axis=1).min() < _NEAR:
                return f"{crs} with x and y swapped" if swap else crs
    return ""
