# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the building can be in a photo, from the sparse points that are the building.

The building is taken as those points and the columns below them: walls reach the ground even where bushes always
hid their foot. Pixels far from all of them are not the building; background pixels *on* them show something that
stands in front (unknown, never "empty space").
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.ground import Ground
from mgf_engine.masks.shape import Shape
from mgf_engine.scene.model import Scene, View

#: Maps are drawn on a photo of about this longest side.
MAP_SIDE = 250
MAX_COLUMN = 40  # samples between a point and the ground


@dataclass(frozen=True)
class Extent:
    """Samples of the building [M, 3] and the distance [M] to the next one, normalised units."""

    samples: NDArray[np.float64]
    spacing: NDArray[np.float64]

    def cover(self, view: View, reach: float) -> NDArray[np.bool_]:
        """Pixels within ``reach`` spacings of a sample, on the reduced map, bool [h, w]."""
        factor = min(1.0, MAP_SIDE / max(view.width, view.height))
        h, w = max(1, round(view.height * factor)), max(1, round(view.width * factor))
        uv, depth = view.project(self.samples)
        result = np.zeros((h, w), np.uint8)
        radius = reach * self.spacing * view.fx / np.maximum(depth, 1e-6) * factor
        x, y = np.floor(uv[:, 0] * w / view.width), np.floor(uv[:, 1] * h / view.height)
        seen = (depth > 0) & (x >= 0) & (x < w) & (y >= 0) & (y < h)
        level = np.clip(np.round(2 * np.log2(np.maximum(radius, 1))), 0, 2 * np.log2(MAP_SIDE / 4)).astype(int)
        for step in np.unique(level[seen]):
            rows = seen & (level == step)
            spots = np.zeros((h, w), np.uint8)
            spots[y[rows].astype(int), x[rows].astype(int)] = 1
            size = 2 * round(2 ** (step / 2)) + 1
            result |= cv2.dilate(spots, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)))
        return result.astype(bool)

    def core(self, view: View) -> NDArray[np.bool_]:
        """Pixels whose ray meets the building between its samples, without reaching beyond them; reduced map."""
        near = self.cover(view, 1.5).astype(np.uint8)
        if not near.any():
            return near.astype(bool)
        uv, depth = view.project(self.samples)
        seen = (depth > 0) & (uv >= 0).all(1) & (uv[:, 0] < view.width) & (uv[:, 1] < view.height)
        typical = np.median(1.5 * self.spacing[seen] * view.fx / depth[seen]) if seen.any() else 1.0
        size = 2 * round(max(1.0, typical * near.shape[1] / view.width)) + 1
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
        return cv2.erode(near, kernel, borderType=cv2.BORDER_REPLICATE).astype(bool)


def make_extent(scene: Scene, shape: Shape, keep: NDArray[np.bool_], ground: Ground | None) -> Extent:
    """The extent of the kept points; columns end on the ground, or at the lowest kept points around."""
    points, spacing = scene.points[keep], shape.spacing[keep]
    if not len(points):
        return Extent(np.zeros((0, 3)), np.zeros(0))
    spacing = np.clip(spacing, 0.5 * np.median(spacing), 3 * np.median(spacing))
    height = np.maximum(ground.height(points), 0) if ground is not None else shape.height[keep]
    step = np.maximum(spacing, height / MAX_COLUMN)
    count = np.floor(height / step).astype(np.int64) + 1
    owner = np.repeat(np.arange(len(points)), count)
    rank = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    samples = points[owner] - (rank * step[owner])[:, None] * shape.up
    return _thin(samples, step[owner])


def _thin(samples: NDArray[np.float64], spacing: NDArray[np.float64]) -> Extent:
    """One sample per cell of half the median spacing; columns of neighbouring points overlap."""
    cell = 0.5 * float(np.median(spacing))
    _, first = np.unique(np.floor(samples / cell).astype(np.int64), axis=0, return_index=True)
    return Extent(samples[first], spacing[first])
