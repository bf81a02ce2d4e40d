# SPDX-License-Identifier: GPL-3.0-or-later
"""Hulls of buildings: a footprint and the range of heights that the sparse points show above and around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray

from mgf_engine.options.algorithms import parameter

Array = NDArray[np.float64]

#: What can be said of a building before its job. ``doubtful`` ones get no clicks; clicks by hand settle them.
READY, BY_HAND, DOUBTFUL, GONE, UNSEEN = "ready", "by hand", "doubtful", "nothing there", "not photographed"
UNMAPPED = "not in the map"
#: States of buildings that get a job; the Snakefile has them, too.
WITH_JOB = (READY, BY_HAND)


@dataclass(frozen=True)
class BuildingHullOptions:
    """Options of the hulls of buildings."""

    slack: float = parameter(0.6, "Largest error of a footprint", "m")
    ring: tuple[float, float] = parameter(
        (1.0, 7.0), "Inner and outer distance of the ring around a building in which the ground is sought", "m"
    )
    lowest: float = parameter(2.0, "Minimum height of a building", "m")
    above: float = parameter(1.2, "Height above the ground at which a building begins", "m")
    least_points: int = parameter(8, "Minimum number of points for the height of a building", low=4)


@dataclass(frozen=True)
class Hull:
    """A building as a prism in the local frame.

    Attributes:
        id: of the footprint.
        polygon: shapely, local frame.
        low, high: heights of ground and top.
        points: number of sparse points on it.
        state: one of :data:`READY`, :data:`DOUBTFUL`, :data:`GONE`, :data:`UNMAPPED`.
        reason: one sentence where it is not ready.
        height_known: points tell the top; else it is that of the lowest building.
    """

    id: str
    polygon: shapely.Geometry
    low: float
    high: float
    points: int
    state: str = READY
    reason: str = ""
    height_known: bool = True


def make_hulls(
    ids: Sequence[str],
    polygons: NDArray[np.object_],
    points: Array,
    metre: float,
    options: BuildingHullOptions = BuildingHullOptions(),
) -> list[Hull]:
    """Make a hull for each footprint.

    Args:
        ids: names of the footprints.
        polygons: shapely [N], local frame.
        points: [P, 3] sparse points, local frame, z up.
        metre: length of a metre there.
        options: heights over the ground, and what counts as a building.
    """
    flat = shapely.points(points[:, :2])
    tree = shapely.STRtree(flat)
    built = shapely.STRtree(polygons)
    usual = float(np.percentile(points[:, 2], 10))
    hulls = []
    for name, polygon in zip(ids, polygons, strict=True):
        around = polygon.buffer(options.ring[1] * metre).difference(polygon.buffer(options.ring[0] * metre))
        others = [polygons[k].buffer(options.slack * metre) for k in built.query(around) if polygons[k] is not polygon]
        ring = points[tree.query(around.difference(shapely.union_all(others)), predicate="intersects")]
        inside = points[tree.query(polygon.buffer(0.5 * options.slack * metre), predicate="intersects")]
        hulls.append(_hull(name, polygon, ring[:, 2], inside[:, 2], usual, metre, options))
    return hulls


def _hull(
    name: str,
    polygon: shapely.Geometry,
    ring: Array,
    inside: Array,
    usual: float,
    metre: float,
    options: BuildingHullOptions,
) -> Hull:
    """Make the hull of a footprint from the heights of the points around it and on it.

    Args:
        name: id of the footprint.
        polygon: shapely, local frame.
        ring: heights of the points around it.
        inside: heights of the points on it.
        usual: height of the ground where too few points lie around it.
        metre: length of a metre in the local frame.
        options: least height and number of points.
    """
    ground = ground_of(ring) if len(ring) >= options.least_points else usual
    raised = inside[inside > ground + options.above * metre]
    if len(raised) >= options.least_points:
        top = float(np.percentile(raised, 98))
        if top - ground >= options.lowest * metre:
            return Hull(name, polygon, ground, top + 0.2 * metre, len(raised))
    if len(inside) - len(raised) >= options.least_points:
        reason = f"The points show ground where the map has a building ({len(inside)} points, {len(raised)} above it)."
        return Hull(name, polygon, ground, ground + options.lowest * metre, len(raised), GONE, reason, False)
    reason = f"Only {len(raised)} points lie on it, too few to tell its height; click it by hand if it is there."
    return Hull(name, polygon, ground, ground + options.lowest * metre, len(raised), DOUBTFUL, reason, False)


def ground_of(heights: Array) -> float:
    """Estimate the height of the ground from heights of points on it and on objects: the densest of the lower half."""
    low = np.sort(heights[heights <= np.median(heights)])
    if len(low) < 4:
        return float(low[0])
    width = len(low) // 2  # of the shortest interval with half of them: least median of squares (Rousseeuw 1984)
    spans = low[width:] - low[: len(low) - width]
    start = int(np.argmin(spans))
    return float(np.median(low[start : start + width + 1]))


def prism(polygon: shapely.Geometry, low: float, high: float) -> tuple[Array, NDArray[np.int32]]:
    """Return walls and roof of a polygon between two heights: vertices [N, 3], faces [F, 3]; no floor."""
    corners, faces, count = [], [], 0
    for part in getattr(polygon, "geoms", [polygon]):
        for ring in (part.exterior, *part.interiors):
            line = shapely.get_coordinates(ring)[:-1]
            n = len(line)
            corners += [np.c_[line, np.full(n, low)], np.c_[line, np.full(n, high)]]
            k = np.arange(n)
            a, b = count + k, count + (k + 1) % n
            faces += [np.stack([a, b, b + n], 1), np.stack([a, b + n, a + n], 1)]
            count += 2 * n
        for triangle in shapely.constrained_delaunay_triangles(part).geoms:
            corners.append(np.c_[shapely.get_coordinates(triangle)[:3], np.full(3, high)])
            faces.append(np.array([[count, count + 1, count + 2]]))
            count += 3
    return np.concatenate(corners), np.concatenate(faces).astype(np.int32)


def sample_prism(polygon: shapely.Geometry, low: float, high: float, spacing: float) -> tuple[Array, Array]:
    """Return points spread over walls and roof of a prism, [S, 3], and their outward normals [S, 3].

    Args:
        polygon: the footprint, shapely.
        low: height of the floor.
        high: height of the roof.
        spacing: distance of the points.
    """
    places, normals = [], []
    levels = max(1, round((high - low) / spacing))
    heights = low + (high - low) * (np.arange(levels) + 0.5) / levels
    for part in getattr(polygon, "geoms", [polygon]):
        for ring in shapely.normalize(part).boundary.geoms if part.interiors else [shapely.normalize(part).exterior]:
            line = shapely.get_coordinates(ring)
            for a, b in pairwise(line):
                length = float(np.linalg.norm(b - a))
                if length < 1e-9:  # maps name corners twice
                    continue
                steps = max(1, round(length / spacing))
                out = np.array([b[1] - a[1], a[0] - b[0]]) / length
                middle = (a + b) / 2 + 1e-3 * length * out
                out = -out if part.contains(shapely.Point(*middle)) else out
                for share in (np.arange(steps) + 0.5) / steps:
                    places += [(*(a + share * (b - a)), z) for z in heights]
                    normals += [(*out, 0.0)] * levels
        x0, y0, x1, y1 = part.bounds
        grid = np.stack(np.meshgrid(np.arange(x0 + spacing / 2, x1, spacing), np.arange(y0 + spacing / 2, y1, spacing)))
        spots = grid.reshape(2, -1).T
        spots = spots[shapely.contains_xy(part, spots)] if len(spots) else spots
        spots = spots if len(spots) else shapely.get_coordinates(part.representative_point())
        places += [(*spot, high) for spot in spots]
        normals += [(0.0, 0.0, 1.0)] * len(spots)
    return np.array(places), np.array(normals)
