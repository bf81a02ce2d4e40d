# SPDX-License-Identifier: GPL-3.0-or-later
"""Judge points by masks: what lies outside the visual hull is free, whatever the depths say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.algorithms import parameter
from mgf_engine.config import job_option
from mgf_engine.model.masks import BACKGROUND, IGNORE, MaskSet
from mgf_engine.model.scene import Scene
from mgf_engine.raster import points as kernel


@dataclass(frozen=True)
class HullOptions:
    """Options of the visual hull that is carved (``visual_hull``)."""

    share: float = parameter(
        0.25, "Share of the photos that must call a point background for it to be free, of those that judge it", high=1
    )
    views: int = parameter(2, "Number of photos that may call a point background that as many show on the building")
    carve: bool = job_option("visual_hull")


def outside_hull(
    background: NDArray[np.integer], seen: NDArray[np.integer], options: HullOptions = HullOptions()
) -> NDArray[np.bool_]:
    """Find points outside the visual hull by how many views call them background and how many building, bool [N]."""
    return background > np.maximum(options.share * (background + seen), np.minimum(options.views, seen))


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
    """Convert the label maps of ``views`` for the fields, see :func:`judging_mask`.

    Args:
        scene: whose views the masks are of.
        masks: label maps of all views.
        views: numbers of those that are converted.
        dilation: px by which masks grow.
    """
    return [judging_mask(masks.labels[i], dilation) for i in views]
