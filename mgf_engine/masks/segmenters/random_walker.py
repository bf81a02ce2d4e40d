# SPDX-License-Identifier: GPL-3.0-or-later
"""The segmenter that needs no weights: the probability of building, drawn to this photo's edges.

The probability (``propagation/random_walker.py``) comes from a random walk over superpixels and points of all photos
(Grady, *Random walks for image segmentation*, 2006) and from models of colour. Here it is brought to working
resolution, drawn to the photo's edges by a guided filter, and cleaned: holes without evidence are filled (dark windows,
white walls), specks without a point are dropped.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.segmenters.base import Hints, Segment, agreement, inside

#: Pieces and holes below this share of the photo are noise unless points say otherwise.
SPECK = 0.002
HOLE = 0.02


class RandomWalker:
    """BuildingProbability to mask; stateless."""

    name = "random_walker"

    def segment(self, index: int, photo: NDArray[np.uint8], hints: Hints, attempt: int = 0) -> Segment:
        """See :class:`mgf_engine.masks.segmenters.base.Segmenter`; a second attempt follows the points closer.

        Args:
            index: number of the photo in the scene.
            photo: RGB uint8 [H, W, 3].
            hints: clicks and points on the building and beside it.
            attempt: 0 for the first; a further one follows the points closer.
        """
        probability = hints.probability if attempt == 0 else follow_points(hints)
        mask = clean(to_edges(photo, probability) > 0.5, hints)
        return Segment(mask, agreement(mask, hints))


def follow_points(hints: Hints) -> NDArray[np.float32]:
    """Return the probability bent towards the points of this photo: each speaks for the pixels around it."""
    h, w = hints.probability.shape
    radius = 0.02 * max(h, w)
    votes = np.zeros((2, h, w), np.float32)
    for plane, points in zip(votes, (hints.rejected, hints.accepted), strict=True):
        x = np.clip(np.floor(points[:, 0]).astype(int), 0, w - 1)
        y = np.clip(np.floor(points[:, 1]).astype(int), 0, h - 1)
        np.add.at(plane, (y, x), 1)
    near = [cv2.GaussianBlur(v, (0, 0), radius) * (2 * np.pi * radius**2) for v in votes]
    weight = 0.5  # the probability counts like half a point
    return ((near[1] + weight * hints.probability) / (near[0] + near[1] + weight)).astype(np.float32)


def to_edges(photo: NDArray[np.uint8], probability: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the probability drawn to the photo's edges, float32 [H, W]."""
    radius = max(4, round(max(photo.shape[:2]) / 100))
    guide = cv2.cvtColor(photo, cv2.COLOR_RGB2LAB)
    return np.asarray(cv2.ximgproc.guidedFilter(guide, probability, radius, (0.03 * 255) ** 2), np.float32)


def clean(mask: NDArray[np.bool_], hints: Hints) -> NDArray[np.bool_]:
    """Drop specks, fill holes; points and clicks that say otherwise win."""
    mask = _fill(mask, hints.accepted, hints.positive, SPECK, value=False)
    return _fill(mask, hints.rejected, hints.negative, HOLE, value=True)


def _fill(mask: NDArray[np.bool_], points: NDArray, clicks: NDArray, share: float, value: bool) -> NDArray[np.bool_]:
    """Turn small pieces that are not ``value`` into it, unless a click or enough points lie on them."""
    pieces = (mask != value).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(pieces, connectivity=4)
    evidence = np.zeros(count, np.int64)
    for found, weight in ((points, 1), (clicks, 100)):
        rows = found[inside(pieces.astype(bool), found)]
        x, y = np.floor(rows).astype(np.int64).T if len(rows) else (np.zeros(0, int), np.zeros(0, int))
        np.add.at(evidence, labels[np.clip(y, 0, mask.shape[0] - 1), np.clip(x, 0, mask.shape[1] - 1)], weight)
    small = (stats[:, cv2.CC_STAT_AREA] < share * mask.size) & (evidence < 3)
    small[0] = False
    result = mask.copy()
    result[small[labels]] = value
    return result
