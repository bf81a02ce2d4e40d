# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks against true masks: overlap, where the outline lies, elements inside the building."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.boundaries import boundaries
from mgf_engine.model.masks import BACKGROUND, FIRST_ELEMENT, IGNORE, building

Labels = NDArray[np.uint8]
#: px; outlines farther from the truth than this are another object's, not a tight or loose one.
EDGE_REACH = 6.0
#: px; a boundary this near a true one is the same.
SAME_BOUNDARY = 2
#: Elements below this share of the building are not scored.
SMALLEST_ELEMENT = 0.002


@dataclass(frozen=True)
class PhotoScore:
    """One photo against its truth.

    Attributes:
        iou: of the building, 0..1, where the truth is not an occluder; NaN where neither shows any building.
        edge: mean signed distance of the outline from the true one in pixels, positive where it is too wide;
            NaN without an outline near the true one.
        occluded: pixels called building where the truth is something in front of it, as a share of the building.
        element_boundaries: F1 of the boundaries inside the building at 2 px, 0..1; NaN without true elements.
        element_overlap: mean over the true elements of the IoU with the best own one, 0..1; NaN without any.
    """

    iou: float
    edge: float
    occluded: float
    element_boundaries: float
    element_overlap: float


def score_photo(labels: Labels, truth: Labels, elements: Labels) -> PhotoScore:
    """Score a label map; ``truth`` is the true level-one mask, ``elements`` the same with elements; all [H, W]."""
    valid = truth != IGNORE
    mine, true = building(labels) & valid, building(truth) & valid
    union = int((mine | true).sum())
    iou = float((mine & true).sum()) / union if union else float("nan")
    occluded = float((building(labels) & ~valid).sum()) / max(1, int(true.sum()))
    inner = _element_boundaries(labels, elements), _element_overlap(labels, elements)
    return PhotoScore(iou, edge_bias(mine, true, valid), occluded, *inner)


def edge_bias(mine: NDArray[np.bool_], true: NDArray[np.bool_], valid: NDArray[np.bool_]) -> float:
    """Mean signed distance in pixels of the outline of ``mine`` from that of ``true``, both [H, W]; + is too wide."""
    if not mine.any() or not true.any() or mine.all() or true.all():
        return float("nan")
    outside = cv2.distanceTransform((~true).astype(np.uint8), cv2.DIST_L2, 5)
    inside = cv2.distanceTransform(true.astype(np.uint8), cv2.DIST_L2, 5)
    signed = np.where(true, 0.5 - inside, outside - 0.5)
    near_unknown = cv2.dilate((~valid).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    # The outline runs between two pixels: take both, so that an exact one scores zero.
    edge = boundaries(mine.astype(np.uint8)) & ~near_unknown & (np.abs(signed) <= EDGE_REACH)
    edge[[0, -1]] = edge[:, [0, -1]] = False
    return float(signed[edge].mean()) if edge.any() else float("nan")


def _element_boundaries(labels: Labels, elements: Labels) -> float:
    scored = cv2.erode(building(elements).astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
    both = np.where(building(labels), labels, BACKGROUND).astype(np.uint8)
    mine, true = boundaries(both) & scored, boundaries(elements) & scored
    if not true.any():
        return float("nan")
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * SAME_BOUNDARY + 1, 2 * SAME_BOUNDARY + 1))
    near_true, near_mine = (cv2.dilate(b.astype(np.uint8), kernel) > 0 for b in (true, mine))
    precision = float((mine & near_true).sum()) / max(1, int(mine.sum()))
    recall = float((true & near_mine).sum()) / int(true.sum())
    return 2 * precision * recall / max(precision + recall, 1e-9)


def _element_overlap(labels: Labels, elements: Labels) -> float:
    total = int(building(elements).sum())
    values = []
    for value in np.unique(elements[(elements >= FIRST_ELEMENT) & (elements != IGNORE)]):
        # Ids may be shared by several elements of one kind: each connected piece is one.
        count, pieces, stats, _ = cv2.connectedComponentsWithStats((elements == value).astype(np.uint8), connectivity=4)
        for piece in range(1, count):
            if stats[piece, cv2.CC_STAT_AREA] < SMALLEST_ELEMENT * total:
                continue
            values.append(_best_overlap(labels, pieces == piece))
    return float(np.mean(values)) if values else float("nan")


def _best_overlap(labels: Labels, element: NDArray[np.bool_]) -> float:
    area = int(element.sum())
    found, shared = np.unique(labels[element], return_counts=True)
    best = 0.0
    for value, count in zip(found, shared, strict=True):
        if value not in (BACKGROUND, IGNORE):
            best = max(best, float(count) / (area + int((labels == value).sum()) - int(count)))
    return best
