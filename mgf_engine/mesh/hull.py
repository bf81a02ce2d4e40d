# SPDX-License-Identifier: GPL-3.0-or-later
"""Visual hull of the masks: points outside of it are free space, whatever the depth maps show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.model.masks import BACKGROUND, IGNORE, MaskSet
from mgf_engine.options.algorithms import parameter
from mgf_engine.options.config import job_option
from mgf_engine.raster import points as kernel


@dataclass(frozen=True)
class HullOptions:
    """Options of the visual hull (the option ``visual_hull`` turns it on)."""

    share: float = parameter(
        0.25,
        "Minimum share of the photos that see a point as background for it to be free, among those that see it",
        high=1,
    )
    views: int = parameter(2, "Number of photos that may see a point as background if as many see it on the building")
    carve: bool = job_option("visual_hull")


def outside_hull(
    background: NDArray[np.integer], seen: NDArray[np.integer], options: HullOptions = HullOptions()
) -> NDArray[np.bool_]:
    """Find the points outside the visual hull, bool [N].

    Args:
        background: number of views whose mask shows background at the point, [N].
        seen: number of views whose mask shows the building there, [N].
        options: how many views must show background.
    """
    return background > np.maximum(options.share * (background + seen), np.minimum(options.views, seen))


def silhouette_mask(labels: NDArray[np.uint8], dilation: int) -> NDArray[np.uint8]:
    """Convert a label map [H, W] to INSIDE, OUTSIDE and IGNORE of :mod:`mgf_engine.raster.points`, uint8 [H, W].

    The inside is dilated by ``dilation`` px.
    """
    known = (labels != BACKGROUND).astype(np.uint8)
    if dilation > 0:
        size = 2 * dilation + 1
        near = cv2.dilate(known, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)))
    else:
        near = known
    result = np.where(near > 0, kernel.INSIDE, kernel.OUTSIDE).astype(np.uint8)
    result[labels == IGNORE] = kernel.IGNORE
    return result


def silhouette_masks(masks: MaskSet, views: Sequence[int], dilation: int) -> list[NDArray[np.uint8]]:
    """Convert the label maps of some views by :func:`silhouette_mask`.

    Args:
        masks: label maps of all views.
        views: numbers of the views whose masks are converted.
        dilation: of the masks, px.
    """
    return [silhouette_mask(masks.labels[i], dilation) for i in views]
