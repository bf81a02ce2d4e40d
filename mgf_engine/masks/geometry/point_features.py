# SPDX-License-Identifier: GPL-3.0-or-later
"""Local features of the sparse points: neighbours, normals, flatness, height above their surroundings."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mgf_engine.geometry.components import label_components
from mgf_engine.masks.geometry.plan_grid import PlanGrid
from mgf_engine.model.scene import Scene
from mgf_engine.options.algorithms import parameter
from mgf_engine.scene.gravity import horizontal_axes, up_from_cameras

_PLAN_CELLS, _PLAN_MARGIN = 12, 3  # along the longer side of what most points cover, and beyond it on each side


@dataclass(frozen=True)
class PointFeatureOptions:
    """Options of the features of points."""

    neighbours: int = parameter(10, "Number of neighbours of a point", low=3)
    astray: float = parameter(1.5, "Spacing of a stray point, as a multiple of its neighbours'")
    one_sided: float = parameter(
        0.75, "Distance of a stray point's neighbours' centroid, as a share of their mean distance", high=1
    )
    group_gap: float = parameter(4.0, "Gap between two groups of points", "point spacings", low=0.1)


@dataclass(frozen=True)
class PointFeatures:
    """Local shape around each of ``P`` sparse points.

    Attributes:
        up: unit vector [3], normalised frame.
        spacing: float64 [P], distance to the neighbours (their median).
        normals: float64 [P, 3], unit, sign arbitrary.
        flatness: float64 [P], 0 (scattered) .. 1 (planar).
        height: float64 [P], over the lowest surface around, in normalised units.
        pairs: int64 [E, 2] neighbours in space.
        closeness: float64 [E], 0..1.
        astray: bool [P], beside others that lie together and away from all of them: matches slide along eaves.
    """

    up: NDArray[np.float64]
    spacing: NDArray[np.float64]
    normals: NDArray[np.float64]
    flatness: NDArray[np.float64]
    height: NDArray[np.float64]
    pairs: NDArray[np.int64]
    closeness: NDArray[np.float64]
    astray: NDArray[np.bool_]

    def supported(self, keep: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return kept points that are not alone: close enough to neighbours of which half are kept; bool [P]."""
        if not keep.any():
            return keep
        first, second = self.pairs[:, 0], self.pairs[:, 1]
        share = np.bincount(first, keep[second], len(keep)) / np.maximum(np.bincount(first, minlength=len(keep)), 1)
        return keep & (share >= 0.5) & (self.spacing < 4 * np.median(self.spacing[keep]))


def measure_point_features(
    scene: Scene, up: NDArray[np.float64] | None = None, options: PointFeatureOptions = PointFeatureOptions()
) -> PointFeatures:
    """Measure neighbours, normals and heights of the sparse points of a scene.

    Args:
        up: [3], normalised frame; None to estimate it from the cameras.
    """
    points = scene.points
    count = len(points)
    up = up_from_cameras(scene.views) if up is None else up
    k = min(options.neighbours, count - 1)
    if k < 1:
        zero, none = np.zeros(count), np.zeros(count, bool)
        return PointFeatures(
            up, zero + 1, np.tile(up, (count, 1)), zero, zero, np.zeros((0, 2), np.int64), np.zeros(0), none
        )
    tree = cKDTree(points)
    distance, index = tree.query(points, k + 1)
    distance, index = distance[:, 1:], index[:, 1:]
    spacing = np.maximum(np.median(distance, 1), 1e-9)
    offsets = points[index] - points[:, None]
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets) / k)
    normals = vectors[:, :, 0]
    flatness = 1 - np.sqrt(np.maximum(values[:, 0], 0) / np.maximum(values[:, 1], 1e-18))
    pairs, closeness = _links(distance, index, spacing, normals, flatness)
    loose = _astray(offsets, spacing, index, options)
    return PointFeatures(up, spacing, normals, flatness, _heights(points @ up, points, up), pairs, closeness, loose)


def _astray(offsets: NDArray, spacing: NDArray, index: NDArray, options: PointFeatureOptions) -> NDArray[np.bool_]:
    """Find points beside their neighbours ``index`` [P, K] and away from them, by the offsets [P, K, 3] to these."""
    one_sided = np.linalg.norm(offsets.mean(1), axis=1) > options.one_sided * np.linalg.norm(offsets, axis=2).mean(1)
    return np.asarray(one_sided & (spacing > options.astray * spacing[index].mean(1)), bool)


def _links(
    distance: NDArray, index: NDArray, spacing: NDArray, normals: NDArray, flatness: NDArray
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the pairs of neighbours and their closeness: near (self-tuning), and of the same direction where both are
    planar."""
    count, k = index.shape
    first, second = np.repeat(np.arange(count), k), index.ravel()
    near = np.exp(-(distance.ravel() ** 2) / (2 * spacing[first] * spacing[second]))
    turn = 1 - np.abs((normals[first] * normals[second]).sum(1))
    planar = np.clip(np.minimum(flatness[first], flatness[second]), 0, 1)
    return np.stack([first, second], 1), near * np.exp(-4 * planar * turn)


def _heights(level: NDArray, points: NDArray, up: NDArray) -> NDArray[np.float64]:
    """Return height over the lowest points (5th percentile) of the 3 x 3 cells around, on a grid of the ground plan."""
    axes = horizontal_axes(up)
    low, high = np.percentile(points @ axes.T, [2, 98], axis=0)
    grid = PlanGrid(axes, low, max(float((high - low).max()) / _PLAN_CELLS, 1e-9))
    cells = np.clip(grid.cells(points), -_PLAN_MARGIN, _PLAN_CELLS + _PLAN_MARGIN) + _PLAN_MARGIN
    side = _PLAN_CELLS + 1 + 2 * _PLAN_MARGIN
    floor = np.full((side, side), np.inf)
    number = np.ravel_multi_index(tuple(cells.T), floor.shape)
    order = np.argsort(number)
    cuts = np.searchsorted(number[order], np.arange(floor.size + 1))
    for key, (start, end) in enumerate(pairwise(cuts)):
        if end - start >= 3:
            floor.flat[key] = np.percentile(level[order[start:end]], 5)
    padded = np.pad(floor, 1, constant_values=np.inf)
    lowest = np.min([padded[i : i + side, j : j + side] for i in range(3) for j in range(3)], axis=0)
    lowest[~np.isfinite(lowest)] = np.percentile(level, 5)
    return np.maximum(level - lowest[cells[:, 0], cells[:, 1]], 0)


def clicked_groups(
    points: NDArray[np.float64],
    keep: NDArray[np.bool_],
    clicked: NDArray[np.int64],
    features: PointFeatures,
    options: PointFeatureOptions = PointFeatureOptions(),
) -> NDArray[np.bool_]:
    """Find kept points that hang together with clicked ones: a building of the same brick across the street does not.

    Points hang together where no gap of about eight spacings lies between them.

    Args:
        points: [P, 3]; keep: [P].
        clicked: rows of the points that were clicked on.
        features: neighbours and spacing of the points.
        options: the gap that parts two groups.

    Returns:
        bool [P]; all kept points where no clicked one is among them.
    """
    clicked = clicked[keep[clicked]]
    if not len(clicked):
        return keep
    cell = options.group_gap * float(np.median(features.spacing[keep]))
    rows = np.flatnonzero(keep)
    cells, which = np.unique(np.floor(points[rows] / cell).astype(np.int64), axis=0, return_inverse=True)
    tree = cKDTree(cells)
    pairs = tree.query_pairs(1.8, output_type="ndarray")  # the 26 cells around
    group = label_components(len(cells), *pairs.T)[which.ravel()]
    result = np.zeros(len(points), bool)
    result[rows] = np.isin(group, group[np.isin(rows, clicked)])
    return result
