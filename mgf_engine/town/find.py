# SPDX-License-Identifier: GPL-3.0-or-later
"""Find buildings in the sparse points alone: connected groups above the ground with planar parts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from mgf_engine.errors import BadInput
from mgf_engine.model.scene import Scene
from mgf_engine.options.algorithms import parameter
from mgf_engine.options.config import Config
from mgf_engine.town.footprints import Footprints
from mgf_engine.town.hulls import BuildingHullOptions
from mgf_engine.town.place import PlacedFootprints, local_points, place_scene

Array = NDArray[np.float64]


@dataclass(frozen=True)
class OutlineOptions:
    """Options of the search for buildings."""

    ground_cell: float = parameter(1.5, "Side of the cells of the ground", "m", low=0.1)
    widest: float = parameter(40.0, "Width of the widest building", "m")
    cell: float = parameter(0.75, "Side of the cells that join points into a building", "m", low=0.1)
    widest_gap: float = parameter(
        4.5, "Width up to which a gap between points along the walls belongs to the building", "m", low=0.0
    )
    least_area: float = parameter(18.0, "Minimum area of a building", "m²")
    least_points: int = parameter(25, "Minimum number of points of a building", low=1)
    planar: float = parameter(
        0.65, "Planarity from which a point lies in a plane (trees have a quarter, roofs two thirds)", high=1
    )
    planar_share: float = parameter(0.5, "Share of a building's points that must lie in planes", high=1)
    scattered: float = parameter(0.5, "Planarity below which a point is taken for leaves", high=1)
    neighbours: int = parameter(10, "Number of neighbours that planarity is measured in", low=3)
    slope_rounds: int = parameter(8, "Number of rounds of fitting the slope of the ground", low=1)
    slope_points: float = parameter(
        60.0, "Percentage of the points, the lower ones, that the slope is fitted to", low=1, high=100
    )
    stray_neighbours: int = parameter(20, "Number of neighbours that the height of a point is compared with", low=1)
    stray_depth: float = parameter(0.8, "Depth below its neighbours from which a point is a wrong match", "m")
    hulls: BuildingHullOptions = BuildingHullOptions()


@dataclass(frozen=True)
class Outline:
    """A connected group of points above the ground that may be a building.

    Attributes:
        polygon: shapely, local frame.
        points: number of points on it.
        flat: share of them that lie in planes.
    """

    polygon: shapely.Geometry
    points: int
    flat: float


def height_over_ground(points: Array, metre: float, options: OutlineOptions = OutlineOptions()) -> Array:
    """Compute the height of each point [P, 3] (local frame), [P]: over an opening of the lowest points wider than
    buildings."""
    cells = _cells(points[:, :2], options.ground_cell * metre, 4000)
    floor = np.full(tuple(cells.max(0) + 1), np.inf)
    sound = ~_below_neighbours(points, metre, options)
    np.minimum.at(floor, tuple(cells[sound].T), points[sound, 2])
    known = np.isfinite(floor)
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    filled = ndimage.median_filter(floor[tuple(nearest)], 3)
    # Without the trend, an opening takes the upper end of a slope for something on the ground.
    trend = _trend(filled, known, options)
    opened = trend + ndimage.grey_opening(
        filled - trend, size=max(3, round(options.widest / options.ground_cell)), mode="nearest"
    )
    return np.asarray(points[:, 2] - opened[tuple(cells.T)])


def _cells(plan: Array, side: float, most: int) -> NDArray[np.int64]:
    """Return the cells of a grid that points [P, 2] lie in, from 0 to ``most``, [P, 2].

    Where they reach farther the grid lies around their median, and stray points far away are left to its rim.
    """
    low, high = plan.min(0), plan.max(0)
    around = np.clip(np.median(plan, axis=0) - 0.5 * most * side, low, np.maximum(low, high - most * side))
    return np.clip(np.floor((plan - around) / side), 0, most).astype(np.int64)


def _trend(floor: Array, known: NDArray[np.bool_], options: OutlineOptions) -> Array:
    """Fit a plane below a map of lowest points [X, Y], in turns to those that lie low over it; its heights, [X, Y]."""
    place = np.column_stack([*np.nonzero(known), np.ones(known.sum())]).astype(float)
    height, kept = floor[known], np.ones(known.sum(), bool)
    plane = np.zeros(3)
    for _ in range(options.slope_rounds):
        plane = np.linalg.lstsq(place[kept], height[kept], rcond=None)[0]
        off = height - place @ plane
        kept = off <= np.percentile(off, options.slope_points)
    x, y = np.indices(floor.shape)
    return np.asarray(plane[0] * x + plane[1] * y + plane[2])


def _below_neighbours(points: Array, metre: float, options: OutlineOptions) -> NDArray[np.bool_]:
    """Tell which points [P, 3] lie far below their neighbours, bool [P]: wrong matches, which lower the ground."""
    index = cKDTree(points[:, :2]).query(points[:, :2], min(options.stray_neighbours, len(points)))[1]
    around = points[index.reshape(len(points), -1), 2]
    return np.asarray(points[:, 2] < np.percentile(around, 30, axis=1) - options.stray_depth * metre)


def find_outlines(points: Array, metre: float, options: OutlineOptions = OutlineOptions()) -> list[Outline]:
    """Find the outlines of what stands on the ground and may be a building, largest first.

    Args:
        points: sparse points of the scene, local frame, [P, 3].
        metre: length of a metre in the local frame.
        options: least sizes, and planarity of roofs and walls.
    """
    rows = np.flatnonzero(height_over_ground(points, metre, options) > options.hulls.lowest * metre)
    if len(rows) < options.least_points:
        return []
    planar = _planar(points[rows], options)
    kept = planar > options.scattered  # leaves would connect houses
    rows, planar = rows[kept], planar[kept]
    plan = points[rows, :2]
    cells = 3 + _cells(plan, options.cell * metre, 8000)
    taken = np.zeros(tuple(cells.max(0) + 4), bool)
    taken[tuple(cells.T)] = True
    closed = ndimage.binary_closing(np.pad(taken, 3), np.ones((3, 3)))[3:-3, 3:-3]
    labels, count = ndimage.label(closed)
    owner = labels[tuple(cells.T)]
    found = []
    for number in range(1, count + 1):
        mine = owner == number
        if mine.sum() < options.least_points:
            continue
        polygon = outline_of(plan[mine], metre, options)
        flat = float((planar[mine] > options.planar).mean())
        if polygon.area >= options.least_area * metre**2 and flat >= options.planar_share:
            found.append(Outline(polygon, int(mine.sum()), flat))
    return sorted(found, key=lambda outline: -float(shapely.area(outline.polygon)))


def _planar(points: Array, options: OutlineOptions) -> Array:
    """Compute the planarity around each point [P, 3], 0 to 1: the median of that of its neighbours, [P]."""
    count = min(options.neighbours, len(points) - 1)
    index = cKDTree(points).query(points, count + 1)[1]
    offsets = points[index] - points[index].mean(1, keepdims=True)
    values = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", offsets, offsets))
    flat = 1 - np.sqrt(np.maximum(values[:, 0], 0) / np.maximum(values[:, 1], 1e-18))
    return np.asarray(np.median(flat[index], axis=1))


def outline_of(plan: Array, metre: float, options: OutlineOptions = OutlineOptions()) -> shapely.Geometry:
    """Return the outline of points [N, 2], a polygon.

    Plain walls and roofs have points at their edges alone, and walls meet at right angles: gaps are closed along both
    directions of the building, within the convex hull of its concave hull (which leaves single points beside it out).
    """
    hull = shapely.concave_hull(shapely.MultiPoint(plan), ratio=0.25).buffer(0.1 * metre)
    box = np.array(shapely.oriented_envelope(hull).exterior.coords)[:2]
    along = (box[1] - box[0]) / max(float(np.linalg.norm(box[1] - box[0])), 1e-12)
    turn = np.array([along, [-along[1], along[0]]])
    turned, cell = plan @ turn.T, options.cell * metre
    filled, low = _fill_gaps(turned, cell, round(options.widest_gap / options.cell))
    squares = shapely.box(*(low + cell * filled).T, *(low + cell * (filled + 1)).T)
    closed = shapely.transform(shapely.union_all(squares), lambda points: points @ turn)
    whole = hull.union(closed.intersection(hull.convex_hull))
    largest = max(getattr(whole, "geoms", [whole]), key=lambda part: float(part.area))  # a corner may touch alone
    return shapely.Polygon(largest.exterior).simplify(0.4 * metre)


def _fill_gaps(points: Array, cell: float, gap: int) -> tuple[NDArray[np.int64], Array]:
    """Close gaps between the cells of points [N, 2] along x and y, of ``gap`` cells at most, until none is left.

    Returns:
        The cells, [M, 2]; the corner of cell 0, 0.
    """
    low = points.min(0)
    cells = np.floor((points - low) / cell).astype(np.int64)
    taken = np.zeros(tuple(cells.max(0) + 1), bool)
    taken[tuple(cells.T)] = True
    taken, before = np.pad(taken, gap + 1), 0
    while taken.sum() > before:
        before = taken.sum()
        for line in (np.ones((gap + 1, 1)), np.ones((1, gap + 1))):
            taken |= ndimage.binary_closing(taken, line)
    return np.argwhere(taken) - (gap + 1), low


def find_buildings(
    scene: Scene, config: Config, warn: Callable[[str], None] = lambda text: None
) -> tuple[Footprints, PlacedFootprints]:
    """Find outlines of buildings in the sparse points, for a scene without a map.

    Returns:
        The outlines as a map would have them, and as placed in the local frame.

    Raises:
        BadInput: nothing stands on the ground.
    """
    georeference, metre = place_scene(scene, config, warn)
    outlines = find_outlines(local_points(scene, georeference), metre, config.algorithm(OutlineOptions))
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
    return footprints, PlacedFootprints(georeference, polygons, metre, georeference.crs, note)
