# SPDX-License-Identifier: GPL-3.0-or-later
"""The segmenter without network weights: thresholds the probability of building, aligned with the photo's edges.

The probability (``propagation/random_walker.py``) comes from a random walk over superpixels and points of all photos
(Grady, *Random walks for image segmentation*, 2006) and from colour models. Here it is upsampled to the working
resolution, aligned with image edges by a guided filter, thresholded and cleaned: holes without evidence are filled
(dark windows, white walls), specks without a point are removed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.segmenters.base import Hints, Segment, agreement, points_on_mask
from mgf_engine.model.pixels import pixel_at
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class MaskDrawingOptions:
    """Options of the masks that are drawn from probabilities."""

    speck: float = parameter(0.002, "Share of the photo below which a piece without points on it is noise", high=1)
    hole: float = parameter(0.02, "Share of the photo below which a hole without points in it is filled", high=1)
    least_points: int = parameter(3, "Number of points that keep a piece or a hole", low=1)
    edge: float = parameter(
        0.03,
        "Difference of colour that is an edge to the guided filter and labels of points, as a share of all grey levels",
        low=1e-4,
    )
    radius: float = parameter(0.01, "Radius of the guided filter, as a share of the longer side", high=1)
    near: float = parameter(
        0.02, "Radius within which points label pixels in the second attempt, as a share of the longer side", high=1
    )


class RandomWalker:
    """From the probability of "building" to masks."""

    name = "random_walker"

    def __init__(self, options: MaskDrawingOptions = MaskDrawingOptions()) -> None:
        self.options = options

    def segment(self, photo: NDArray[np.uint8], hints: Hints, attempt: int = 0) -> Segment:
        """See :class:`mgf_engine.masks.segmenters.base.Segmenter`; a second attempt follows the points closer.

        Args:
            photo: RGB uint8 [H, W, 3].
            hints: clicks and points on the building and beside it.
            attempt: 0 for the first; a further one follows the points closer.
        """
        lab = np.asarray(cv2.cvtColor(photo, cv2.COLOR_RGB2LAB), np.uint8)
        probability = hints.probability if attempt == 0 else follow_points(lab, hints, self.options)
        mask = clean(to_edges(lab, probability, self.options) > 0.5, hints, self.options)
        return Segment(mask, agreement(mask, hints))


def follow_points(
    lab: NDArray[np.uint8], hints: Hints, options: MaskDrawingOptions = MaskDrawingOptions()
) -> NDArray[np.float32]:
    """Blend the probability with the labels of the sparse points around each pixel, float32 [H, W].

    A label spreads by a domain transform (Gastal and Oliveira 2011) and stops at edges: sky and plain ground hold no
    points of their own that would keep the building's away.

    Args:
        lab: the photo in 8-bit CIELAB, uint8 [H, W, 3].
        hints: probability, and points on the building and beside it.
        options: how far labels spread, and what stops them.
    """
    h, w = hints.probability.shape
    radius = options.near * max(h, w)
    votes = np.zeros((h, w, 3), np.float32)
    for plane, points in enumerate((hints.rejected, hints.accepted)):
        np.add.at(votes[..., plane], pixel_at((h, w), points), 1)
    spread = cv2.ximgproc.dtFilter(lab, votes, radius, options.edge * 255, mode=cv2.ximgproc.DTF_NC)
    near = spread * (2 * np.pi * radius**2)
    weight = 0.5  # weight of the probability: half a point
    return ((near[..., 1] + weight * hints.probability) / (near[..., 0] + near[..., 1] + weight)).astype(np.float32)


def to_edges(
    lab: NDArray[np.uint8], probability: NDArray[np.float32], options: MaskDrawingOptions = MaskDrawingOptions()
) -> NDArray[np.float32]:
    """Align the probability with the edges of the photo (8-bit CIELAB) by a guided filter, float32 [H, W]."""
    radius = max(4, round(options.radius * max(lab.shape[:2])))
    return np.asarray(cv2.ximgproc.guidedFilter(lab, probability, radius, (options.edge * 255) ** 2), np.float32)


def clean(
    mask: NDArray[np.bool_], hints: Hints, options: MaskDrawingOptions = MaskDrawingOptions()
) -> NDArray[np.bool_]:
    """Remove specks and fill holes, except those with points or clicks that contradict."""
    for value, share, points, clicks in (
        (False, options.speck, hints.accepted, hints.positive),
        (True, options.hole, hints.rejected, hints.negative),
    ):
        evidence = ((points, 1), (clicks, options.least_points))
        mask = _fill(mask, evidence, share * mask.size, options.least_points, value)
    return mask


def _fill(
    mask: NDArray[np.bool_], found: Sequence[tuple[NDArray, int]], most: float, enough: int, value: bool
) -> NDArray[np.bool_]:
    """Set small connected pieces that are not ``value`` to it, unless there is enough evidence on them.

    Args:
        mask: bool [H, W].
        found: places [N, 2] in pixels, and what each of them counts.
        most: area below which a piece is small, pixels.
        enough: sum of what is found that keeps a piece.
        value: of the mask around the pieces.
    """
    pieces = (mask != value).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(pieces, connectivity=4)
    evidence = np.zeros(count, np.int64)
    for places, weight in found:
        rows = places[points_on_mask(pieces.astype(bool), places)]
        np.add.at(evidence, labels[pixel_at(mask.shape, rows)], weight)
    small = (stats[:, cv2.CC_STAT_AREA] < most) & (evidence < enough)
    small[0] = False
    result = mask.copy()
    result[small[labels]] = value
    return result
