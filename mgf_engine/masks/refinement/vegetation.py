# SPDX-License-Identifier: GPL-3.0-or-later
"""Set trees in front of the building to ignored, where no sparse point shows that it continues behind them.

As background, they would vote against the wall that other photos see behind the leaves. Trees behind the building that
are visible within its convex outline become ignored as well, which does no harm: other photos see past them.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.image_ops import dilate, erode
from mgf_engine.model.masks import BACKGROUND
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class LeafOptions:
    """Options of leaves in front of the building."""

    gaps: float = parameter(
        0.012, "Largest width of twigs and gaps that belong to the leaves around, as a share of the longer side", high=1
    )
    leafy: float = parameter(0.5, "Vegetation probability from which a region is leaves", high=1)


def find_foreground_leaves(
    labels: NDArray[np.uint8], leafy: NDArray[np.floating], options: LeafOptions = LeafOptions()
) -> NDArray[np.bool_]:
    """Find background pixels that are leaves inside the convex hull of the building and of ignored pixels, bool [H, W].

    Args:
        labels: uint8 [H, W], see :mod:`mgf_engine.model.masks`.
        leafy: [H, W], how much each pixel looks like leaves, 0..1.
    """
    outside = labels == BACKGROUND
    if outside.all():
        return np.zeros_like(outside)
    hull = np.zeros(labels.shape, np.uint8)
    cv2.fillConvexPoly(hull, cv2.convexHull(_ends(~outside)), 1)
    reach = max(1, round(options.gaps * max(labels.shape)))
    leaves = erode(dilate(leafy > options.leafy, reach), reach)
    return np.asarray((hull > 0) & leaves & outside, bool)


def _ends(mask: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Return the first and last pixel (x, y) of the mask in every row that has any: all that a hull needs, [N, 2]."""
    rows = np.flatnonzero(mask.any(axis=1))
    first, last = mask[rows].argmax(axis=1), mask.shape[1] - 1 - mask[rows, ::-1].argmax(axis=1)
    return np.stack([np.concatenate([first, last]), np.concatenate([rows, rows])], axis=1).astype(np.int32)
