# SPDX-License-Identifier: GPL-3.0-or-later
"""Where something stands in front of the building: pixels that are *unknown*, never "empty space".

A ray through a background pixel that would hit the building shows an occluder. The building is taken as its
sparse points and the columns below them (walls reach the ground even where bushes always hid their foot).
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.shape import Shape
from mgf_engine.scene.model import View

#: Coverage is drawn on a photo reduced by this factor; occluders need no finer outline.
REDUCTION = 4
MAX_COLUMN = 40  # samples between a point and the ground


def columns(points: NDArray[np.float64], keep: NDArray[np.bool_], shape: Shape) -> tuple[NDArray, NDArray]:
    """The kept points and samples of the columns below them: positions [M, 3], radii [M] in normalised units."""
    base, spacing, height = points[keep], shape.spacing[keep], shape.height[keep]
    if not len(base):
        return np.zeros((0, 3)), np.zeros(0)
    spacing = np.minimum(spacing, 3 * np.median(spacing))
    step = np.maximum(spacing, height / MAX_COLUMN)
    count = np.floor(height / np.maximum(step, 1e-12)).astype(np.int64) + 1
    owner = np.repeat(np.arange(len(base)), count)
    rank = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    down = (rank * step[owner])[:, None] * shape.up
    return base[owner] - down, np.maximum(spacing, step)[owner]


def covered(view: View, samples: NDArray[np.float64], radii: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Pixels of a view whose ray meets the building as :func:`columns` describes it, bool [H, W]."""
    h, w = -(-view.height // REDUCTION), -(-view.width // REDUCTION)
    uv, depth = view.project(samples)
    size = np.clip(radii * view.fx / np.maximum(depth, 1e-6) / REDUCTION, 1, max(h, w) / 20)
    uv = uv / REDUCTION
    seen = (depth > 0) & np.isfinite(uv).all(1) & (uv > -size[:, None]).all(1)
    seen &= (uv[:, 0] < w + size) & (uv[:, 1] < h + size)
    if not seen.any():
        return np.zeros((view.height, view.width), bool)
    canvas = np.zeros((h, w), np.uint8)
    for (x, y), r in zip(np.round(uv[seen]).astype(int), np.ceil(size[seen]).astype(int), strict=True):
        cv2.circle(canvas, (int(x), int(y)), int(r), 1, -1)
    # Discs reach beyond the outermost points by their radius: take that back.
    margin = round(float(np.median(size[seen])))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * margin + 1, 2 * margin + 1))
    canvas = cv2.erode(canvas, kernel, borderType=cv2.BORDER_REPLICATE)
    full = cv2.resize(canvas, (w * REDUCTION, h * REDUCTION), interpolation=cv2.INTER_NEAREST)
    return full[: view.height, : view.width].astype(bool)
