# SPDX-License-Identifier: GPL-3.0-or-later
"""Draw the mask of one photo: collect the segmenter's hints, and try again if the mask contradicts them."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.boxes import percentile_box
from mgf_engine.masks.prompts import Clicks
from mgf_engine.masks.propagation.propagation_options import PropagationOptions
from mgf_engine.masks.propagation.random_walker import BuildingProbability
from mgf_engine.masks.propagation.superpixels import Superpixels
from mgf_engine.masks.segmenters.base import Hints, Segment, Segmenter
from mgf_engine.model.scene import Scene


def draw_mask(segmenter: Segmenter, photo: NDArray[np.uint8], hints: Hints, options: PropagationOptions) -> Segment:
    """Draw the mask of a photo; if it agrees badly with the hints, try the segmenter's second attempt.

    Args:
        segmenter: that draws it.
        photo: RGB uint8 [H, W, 3].
        hints: clicks, points and probability.
        options: what agrees badly, and how much better the other way must be.
    """
    segment = segmenter.segment(photo, hints)
    if segment.score < options.retry_below:
        again = segmenter.segment(photo, hints, attempt=1)
        if again.score > segment.score + options.retry_gain:
            return again
    return segment


def make_hints(
    scene: Scene,
    index: int,
    clicks: Clicks,
    regions: Superpixels,
    probability: BuildingProbability,
    good: NDArray[np.bool_],
) -> Hints:
    """Make the segmenter's hints for view ``index``; ``good`` marks its observations of the building.

    Args:
        scene: photos and points.
        index: of the view.
        clicks: of the view, working pixels.
        regions: superpixels of the view.
        probability: of the regions of all views.
        good: observations of the view that are on the building, bool [T_v].
    """
    view = scene.views[index]
    uv = scene.track_uv[scene.observations(index)]
    small = probability.regions[index][regions.labels]
    wide = cv2.resize(small, (view.width, view.height), interpolation=cv2.INTER_LINEAR).astype(np.float32)
    return Hints(clicks.positive, clicks.negative, uv[good], uv[~good], _box(uv[good]), wide)


def _box(points: NDArray[np.floating]) -> tuple[float, float, float, float] | None:
    if len(points) < 3:
        return None
    low, high = percentile_box(points, (2, 98))
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])
