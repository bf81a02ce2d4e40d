# SPDX-License-Identifier: GPL-3.0-or-later
"""Keep the preview stable: one more click on the building never loses the building.

The mask of each set of clicks is computed independently, and the colours learnt from one more click may change it
completely. So the masks of the first click on the building, the first two, and so on are merged in order.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.prompts import Clicks
from mgf_engine.masks.propagation.propagation_options import PropagationOptions
from mgf_engine.masks.propagation.superpixels import Superpixels
from mgf_engine.model.pixels import pixel_at

Mask = NDArray[np.bool_]
_CLICK_RADIUS = 1.5  # px around a click that always have its label


def first_clicks(clicks: Clicks) -> list[Clicks]:
    """Return the first click on the building, the first two, ... all of them; each with every click beside it."""
    return [Clicks(clicks.positive[:n], clicks.negative, clicks.parts) for n in range(1, len(clicks.positive) + 1)]


def merge_masks(masks: Sequence[Mask], click_loss: float = PropagationOptions.click_loss) -> Mask:
    """Merge the masks of :func:`first_clicks`: the last one, with what a later click would have lost.

    A click may take away the share ``click_loss`` of the mask before it: that is a correction, more is the building.
    """
    mask = masks[0]
    for later in masks[1:]:
        kept = (mask & later).sum() >= (1 - click_loss) * mask.sum()
        mask = later if kept else mask | later
    return mask


def enforce_clicks(mask: Mask, regions: Superpixels, clicks: Clicks) -> Mask:
    """Add the region of every click on the building that a mask leaves out, remove those of clicks beside it.

    Where clicks of both kinds lie in one region, each pixel of it follows the nearer.
    """
    size = (mask.shape[1], mask.shape[0])
    labels = cv2.resize(regions.labels, size, interpolation=cv2.INTER_NEAREST)
    result, nearer = mask.copy(), _nearer(mask.shape, clicks)
    for points, value in ((clicks.positive, True), (clicks.negative, False)):
        here = labels[pixel_at(mask.shape, points)]
        for label in np.unique(here[result[pixel_at(mask.shape, points)] != value]):
            result[(labels == label) & (nearer == value)] = value
    return set_clicked_pixels(result, clicks)


def set_clicked_pixels(mask: Mask, clicks: Clicks) -> Mask:
    """Set the pixels right around the clicks to their label, as the last step, after any change of size."""
    result, nearer = mask.copy(), _nearer(mask.shape, clicks)
    y, x = np.arange(mask.shape[0])[:, None] + 0.5, np.arange(mask.shape[1]) + 0.5
    kinds = ((clicks.positive, True), (clicks.negative, False))
    for points, value in kinds:
        for u, v in points:
            rows, columns = (slice(max(0, int(c - _CLICK_RADIUS)), int(c + _CLICK_RADIUS) + 1) for c in (v, u))
            near = np.hypot(x[columns] - u, y[rows] - v) <= _CLICK_RADIUS
            result[rows, columns][near & (nearer[rows, columns] == value)] = value
    for points, value in kinds:
        result[pixel_at(mask.shape, points)] = value
    return result


def _nearer(shape: tuple[int, ...], clicks: Clicks) -> Mask:
    """Tell whether the nearest click is one on the building, bool [H, W]."""
    if not len(clicks.negative) or not len(clicks.positive):
        return np.full(shape, bool(len(clicks.positive)))
    away = []
    for points in (clicks.positive, clicks.negative):
        free = np.full(shape, 255, np.uint8)
        free[pixel_at(shape, points)] = 0
        away.append(cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE))
    return np.asarray(away[0] <= away[1], bool)
