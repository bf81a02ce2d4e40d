# SPDX-License-Identifier: GPL-3.0-or-later
"""Interface of the segmenters: hints in, mask and score out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.model.pixels import pixel_at

Points = NDArray[np.floating]

CLICK_POINTS = 10  # weight of a click in the score, in sparse points
PSEUDO_COUNT = 10  # added to the number of rejected points, so that a few of them count less


@dataclass(frozen=True)
class Hints:
    """Evidence about the building in one photo; points are [N, 2] in working pixels.

    Attributes:
        positive, negative: the user's clicks.
        accepted, rejected: keypoints of sparse points that are, or are not, the building, as observed here.
        box: (x0, y0, x1, y1) around the accepted points (2nd to 98th percentile), or None.
        probability: float32 [H, W], probability of building from the models that all photos share.
    """

    positive: Points
    negative: Points
    accepted: Points
    rejected: Points
    box: tuple[float, float, float, float] | None
    probability: NDArray[np.float32]


@dataclass(frozen=True)
class Segment:
    """A mask of one photo: bool [H, W], and its agreement with the hints, 0..1."""

    mask: NDArray[np.bool_]
    score: float


class Segmenter(Protocol):
    """Draws the mask of the building in one photo."""

    name: str

    def segment(self, photo: NDArray[np.uint8], hints: Hints, attempt: int = 0) -> Segment:
        """Return the mask of the building in a photo.

        Args:
            photo: RGB uint8 [H, W, 3].
            hints: clicks, points and probability.
            attempt: 1 should ask differently than 0.
        """
        ...


def agreement(mask: NDArray[np.bool_], hints: Hints) -> float:
    """Return the share of the accepted points inside minus that of the rejected ones, 0..1, with 2 px tolerance."""
    near = cv2.dilate(mask.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)
    deep = cv2.erode(mask.astype(np.uint8), np.ones((5, 5), np.uint8), borderValue=1).astype(bool)
    good = _share(near, hints.accepted, hints.positive, 0)
    bad = _share(deep, hints.rejected, hints.negative, PSEUDO_COUNT)
    return max(0.0, good - bad)


def _share(mask: NDArray[np.bool_], points: Points, clicks: Points, pseudo_count: int) -> float:
    weight = len(points) + CLICK_POINTS * len(clicks)
    return float(points_on_mask(mask, points).sum() + CLICK_POINTS * points_on_mask(mask, clicks).sum()) / max(
        weight + pseudo_count, 1
    )


def points_on_mask(mask: NDArray[np.bool_], points: Points) -> NDArray[np.bool_]:
    """Find the points [N, 2] that fall on the mask, bool [N]."""
    return mask[pixel_at(mask.shape, points)]
