# SPDX-License-Identifier: GPL-3.0-or-later
"""Visual hull of silhouettes against the sky: cells that the silhouettes of several photos hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.components import label_components
from mgf_engine.masks.geometry.ground_plane import GroundPlane
from mgf_engine.masks.refinement.sky_silhouette import SkySilhouette
from mgf_engine.model.scene import View
from mgf_engine.options.algorithms import parameter

_AROUND = [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)]
_HALF_AROUND = [step for step in _AROUND if step > (0, 0, 0)]
_EIGHT = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.int64)


@dataclass(frozen=True)
class SilhouetteHullOptions:
    """Options of the visual hull of silhouettes against the sky."""

    photos: int = parameter(3, "Number of photos that must show a cell in front of the sky", low=1)
    photo_share: float = parameter(
        0.25, "Minimum share of the photos with a silhouette that must show a cell in front of the sky", high=1
    )
    most_cells: int = parameter(3000000, "Maximum number of cells", low=8)
    feet: float = parameter(0.25, "Share of the cells, the lowest, that stand on something", high=1)


@dataclass(frozen=True)
class SilhouetteHull:
    """Cells of the visual hull: integer indices [N, 3], the corner of cell 0 and the side of the cells."""

    places: NDArray[np.int64]
    corner: NDArray[np.float64]
    side: float

    @property
    def centres(self) -> NDArray[np.float64]:
        """Normalised frame, [N, 3]."""
        return self.corner + (self.places + 0.5) * self.side

    def parts(self) -> NDArray[np.int64]:
        """Return the number of the connected part each cell belongs to (26 neighbours), [N]."""
        count = len(self.places)
        if not count:
            return np.zeros(0, np.int64)
        span = int(self.places.max()) + 3
        keys = (self.places[:, 0] * span + self.places[:, 1]) * span + self.places[:, 2]
        order = np.argsort(keys)
        ranked, first, second = keys[order], [], []
        for step in _HALF_AROUND:
            wanted = keys + (step[0] * span + step[1]) * span + step[2]
            at = np.minimum(np.searchsorted(ranked, wanted), count - 1)
            hit = np.flatnonzero(ranked[at] == wanted)
            first.append(hit)
            second.append(order[at[hit]])
        return label_components(count, np.concatenate(first), np.concatenate(second)).astype(np.int64)

    def where(self, keep: NDArray[np.bool_]) -> SilhouetteHull:
        """Return the cells that are kept, [N] bool."""
        return SilhouetteHull(self.places[keep], self.corner, self.side)

    def standing(self, ground: GroundPlane, options: SilhouetteHullOptions = SilhouetteHullOptions()) -> SilhouetteHull:
        """Return the hull with columns from its lowest cells to the ground, which no photo shows against the sky."""
        height = ground.height(self.centres)
        lowest = height < np.quantile(height, options.feet)
        feet, height = self.centres[lowest], height[lowest]
        below = np.arange(1, np.ceil(height.max(initial=0) / self.side) + 1)
        over = height[:, None] - below * self.side > -self.side / 2
        spots = (feet[:, None] - (below * self.side)[:, None] * ground.normal)[over]
        columns = np.floor((spots - self.corner) / self.side).astype(np.int64)
        return SilhouetteHull(np.unique(np.concatenate([self.places, columns]), axis=0), self.corner, self.side)

    def cover(self, view: View) -> NDArray[np.bool_]:
        """Return pixels of a view behind some cell, [H, W]."""
        result = np.zeros((view.height, view.width), np.uint8)
        uv, depth = view.project(self.centres)
        seen = (depth > self.side) & (uv > -0.5).all(1) & (uv[:, 0] < view.width) & (uv[:, 1] < view.height)
        if not seen.any():
            return result > 0
        x, y = np.maximum(np.floor(uv[seen]), 0).astype(np.int64).T
        result[y, x] = 1
        width = int(np.ceil(view.fx * self.side / float(np.median(depth[seen]))))
        return np.asarray(cv2.dilate(result, np.ones((width | 1, width | 1), np.uint8)) > 0, bool)


def carve_silhouette_hull(
    views: Sequence[View],
    outlines: Sequence[SkySilhouette],
    corner: NDArray[np.float64],
    size: float,
    cell: float,
    options: SilhouetteHullOptions = SilhouetteHullOptions(),
) -> SilhouetteHull:
    """Carve a cube: keep the cells inside the silhouettes of several photos that hardly any photo shows as sky.

    Cells are subdivided as an octree while they may be solid, so that empty space is cheap.

    Args:
        views: cameras of the photos.
        outlines: one per view; photos without anything solid have no say.
        corner: lowest corner of the cube, normalised frame, [3]; size: its side.
        cell: the side down to which cells are divided.
        options: how many photos must see a cell as something, and how many may see it as sky.
    """
    summed = [(v, _sums(o.empty), _sums(o.solid)) for v, o in zip(views, outlines, strict=True) if o.solid.any()]
    hull = SilhouetteHull(np.zeros((1, 3), np.int64), corner, size)
    while True:
        hull = hull.where(_may_be_solid(hull, summed, options))
        if hull.side <= cell or len(hull.places) * 8 > options.most_cells or not len(hull.places):
            return hull
        hull = SilhouetteHull((2 * hull.places[:, None] + _EIGHT).reshape(-1, 3), corner, hull.side / 2)


def _may_be_solid(
    hull: SilhouetteHull,
    summed: Sequence[tuple[View, NDArray[np.int32], NDArray[np.int32]]],
    options: SilhouetteHullOptions,
) -> NDArray[np.bool_]:
    centres, radius = hull.centres, hull.side * np.sqrt(3) / 2
    fewest = max(options.photos, round(options.photo_share * len(summed)))
    free, solid = np.zeros(len(centres), np.int32), np.zeros(len(centres), np.int32)
    for view, empty_sums, solid_sums in summed:
        uv, depth = view.project(centres)
        before = depth > 2 * radius
        reach = max(view.fx, view.fy) * radius / np.where(before, depth, 1)
        frame = np.array([view.width, view.height])
        low = np.floor(np.where(before[:, None], uv - reach[:, None], 0)).clip(-1, frame + 1).astype(np.int64)
        high = np.ceil(np.where(before[:, None], uv + reach[:, None], 0)).clip(-1, frame + 1).astype(np.int64)
        inside = before & (low >= 0).all(1) & (high <= frame).all(1)
        low, high = low.clip(0, frame), high.clip(0, frame)
        free += inside & (_within(empty_sums, low, high) == (high - low).prod(1))
        solid += (before & (_within(solid_sums, low, high) > 0)) | (np.abs(depth) <= 2 * radius)
    return np.asarray((free <= 1) & (solid >= fewest), bool)


def _sums(mask: NDArray[np.bool_]) -> NDArray[np.int32]:
    return np.asarray(cv2.integral(mask.astype(np.uint8)), np.int32)


def _within(sums: NDArray[np.int32], low: NDArray[np.int64], high: NDArray[np.int64]) -> NDArray[np.int32]:
    """Return marked pixels in boxes, from summed areas."""
    (x0, y0), (x1, y1) = low.T, high.T
    return np.asarray(sums[y1, x1] - sums[y0, x1] - sums[y1, x0] + sums[y0, x0], np.int32)
