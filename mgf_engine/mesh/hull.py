# SPDX-License-Identifier: GPL-3.0-or-later
"""The visual hull: which points the masks leave for the building, and the masks that views judge with."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.model.masks import BACKGROUND, IGNORE, MaskSet
from mgf_engine.model.scene import Scene
from mgf_engine.raster import points as kernel

HULL_SHARE = 0.25  # a point is outside the visual hull when more than this share of its views call it background,
HULL_FEW = 2  # and more than this many (fewer, where fewer see it on the building)


def outside_hull(background: NDArray[np.integer], seen: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Find points outside the visual hull by how many views call them background and how many building, bool [N]."""
    return background > np.maximum(HULL_SHARE * (background + seen), np.minimum(HULL_FEW, seen))


def judging_mask(labels: NDArray[np.uint8], dilation: int) -> NDArray[np.uint8]:
    """Convert a label map for the fields: OUTSIDE only where background is certain, ``dilation`` px away."""
    known = (labels != BACKGROUND).astype(np.uint8)
    if dilation > 0:
        size = 2 * dilation + 1
        near = cv2.dilate(known, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)))
    else:
        near = known
    result = np.where(near > 0, kernel.INSIDE, kernel.OUTSIDE).astype(np.uint8)
    result[labels == IGNORE] = kernel.IGNORE
    return result


def judging_masks(scene: Scene, masks: MaskSet, views: Sequence[int], dilation: int) -> list[NDArray[np.uint8]]:
    """Convert the label maps of ``views`` for the fields, see :func:`judging_mask`."""
    return [judging_mask(masks.labels[i], dilation) for i in views]
