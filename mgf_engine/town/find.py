# SPDX-License-Identifier: GPL-3.0-or-later
"""Buildings in the sparse points alone: what stands above the ground, hangs together and is flat in parts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from mgf_engine.config import Config
from mgf_engine.errors import BadInput
from mgf_engine.model.scene import Scene
from mgf_engine.town.footprints import Footprints
from mgf_engine.town.hulls import LOWEST
from mgf_engine.town.place import Placed, local_points, place_scene

Array = NDArray[np.float64]
#: Metres: cells of the ground, the widest building, cells of what stands on the ground, the least area of a building;
#: and points of one at least.
_GROUND, _WIDEST, _CELL, _AREA, _FEWEST = 1.5, 40.0, 0.75, 18.0, 25
#: Share of the points of a building whose surroundings are plane: trees have a quarter, roofs and walls two thirds.
_PLANE, _FLAT, _SCATTERED = 0.65, 0.5, 0.5
_NEIGHBOURS = 10
_ROUNDS, _LOWER = 8, 60.0  # of fitting the slope, and the percentage of points that are low enough for it
_AROUND, _STRAY = 20, 0.8  # points whose heights a point is compared with; metres below them that are too much


@dataclass(frozen=True)
class Outline:
    """Something that may be a building.

    Attributes:
        polygon: shapely, local frame.
        points: number of points on it.
        flat: share of them that lie in planes.
    """

    polygon: Any
    points: int
    flat: float


def height_over_ground(points: Array, metre: float) -> Array:
    """Of each point [P, 3] (local frame), [P]: over an opening of the lowest points wider than buildings."""
    low = points[:, :2].min(0)
    cells = np.floor((points[:, :2] - low) / (_GROUND * metre)).astype(np.int64)
    cells = np.minimum(cells, 4000)  # stray points far away are left to its rim
    floor = np.full(tuple(cells.max(0) + 1), np.inf)
    sound = ~_sunken(points, metre)
    np.minimum.at(floor, tuple(cells[sound].T), points[sound, 2])
    known = np.isfinite(floor)
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    filled = ndimage.median_filter(floor[tuple(nearest)], 3)
    trend = _trend(filled, known)  # without it an opening takes the upper rim of a slope for something on the ground
    opened = trend + ndimage.grey_opening(filled - trend, size=max(3, round(_WIDEST / _GROUND)), mode="nearest")
    return np.asarray(points[:, 2] - opened[tuple(cells.T)])


def _trend(floor: Array, known: NDArray[np.bool_]) -> Array:
    """The plane of the slope that lies under a map of lowest points [X, Y]: fitted to the lower ones in turns."""
    place = np.column_stack([*np.nonzero(known), np.ones(known.sum())]).astype(float)
    height, kept = floor[known], np.ones(known.sum(), bool)
    plane = np.zeros(3)
    for _ in range(_ROUNDS):
        plane = np.linalg.lstsq(place[kept], height[kept], rcond=None)[0]
        off = height - place @ plane
        kept = off <= np.percentile(off, _LOWER)
    x, y = np.indices(floor.shape)
    return np.asarray(plane[0] * x + plane[1] * y + plane[2])


def _sunken(points: Array, metre: float) -> NDArray[np.bool_]:
    """Which points [P, 3] lie far below those around them: wrong matches, which would take the ground down."""
    index = cKDTree(points[:, :2]).query(points[:, :2], min(_AROUND, len(points)))[1]
    around = points[index.reshape(len(points), -1), 2]
    return np.asarray(points[:, 2] < np.percentile(around, 30, axis=1) - _STRAY * metre)


def find_outlines(points: Array, metre: float) -> list[Outline]:
    """What stands on the ground and may be a building, the largest first.

    Args:
        points: [P, 3] the sparse points of the scene in the local frame.
    """
    import shapely

    rows = np.flatnonzero(height_over_ground(points, metre) > LOWEST * metre)
    if len(rows) < _FEWEST:
        return []
    planar = _planar(points[rows])
    rows, planar = rows[planar > _SCATTERED], planar[planar > _SCATTERED]  # leaves would tie houses together
    plan = points[rows, :2]
    low = plan.min(0) - 3 * _CELL * metre
    cells = np.minimum(np.floor((plan - low) / (_CELL * metre)).astype(np.int64), 8000)
    taken = np.zeros(tuple(cells.max(0) + 4), bool)
    taken[tuple(cells.T)] = True
    closed = ndimage.binary_closing(np.pad(taken, 3), np.ones((3, 3)))[3:-3, 3:-3]
    labels, count = ndimage.label(closed)
    owner = labels[tuple(cells.T)]
    found = []
    for number in range(1, count + 1):
        mine = owner == number
        if mine.sum() < _FEWEST:
            continue
        polygon = outline_of(plan[mine], metre)
        flat = float((planar[mine] > _PLANE).mean())
        if polygon.area >= _AREA * metre**2 and flat >= _FLAT:
            found.append(Outline(polygon, int(mine.sum()), flat))
    return sorted(found, key=lambda outline: -float(shapely.area(outline.polygon)))


def _planar(points: Array) -> Array:
    """How plane the surroundings of each point [P, 3] are, 0 to 1: the median of its neighbours counts."""
    count = min(_NEIGHBOURS, len(points) - 1)
    index = cKDTree(points).query(points, count + 1)[1]
    offsets = points[index] - points[index].mean(1, keepdims=True)
    values = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", offsets, offsets))
    flat = 1 - np.sqrt(np.maximum(values[:, 0], 0) / np.maximum(values[:, 1], 1e-18))
    return np.asarray(np.median(flat[index], axis=1))


def outline_of(plan: Array, metre: float) -> Any:
    """The outline of points [N, 2]: the rectangle around them where they fill it, else their concave hull."""
    import shapely

    hull = shapely.concave_hull(shapely.MultiPoint(plan), ratio=0.25).buffer(0.1 * metre)
    hull = hull.simplify(0.4 * metre)
    box = shapely.oriented_envelope(hull)
    return box if hull.area > 0.8 * box.area else hull


def find_buildings(
    scene: Scene, config: Config, warn: Callable[[str], None] = lambda text: None
) -> tuple[Footprints, Placed]:
    """Outlines of buildings in the place of a map.

    Raises:
        BadInput: nothing stands on the ground.
    """
    georeference, metre = place_scene(scene, config, warn)
    outlines = find_outlines(local_points(scene, georeference), metre)
    if not outlines:
        raise BadInput(
            "Nothing in the sparse points stands on the ground like a building; give --footprints FILE, or click it."
        )
    polygons = np.empty(len(outlines), object)
    polygons[:] = [outline.polygon for outline in outlines]
    ids = tuple(f"building_{number}" for number in range(1, len(outlines) + 1))
    note = f"{len(ids)} buildings found in the sparse points; edit buildings.geojson and give it as --footprints."
    if not georeference.metric:
        note += f" Nothing tells the scale: a metre is taken as {metre:.3g} units of the scene."
    footprints = Footprints(ids, polygons, georeference.crs, 0, Path("--find"))
    return footprints, Placed(georeference, polygons, metre, georeference.crs, note)
