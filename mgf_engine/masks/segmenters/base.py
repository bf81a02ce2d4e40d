# SPDX-License-Identifier: GPL-3.0-or-later
"""What every segmenter is asked, and what it answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.floating]


@dataclass(frozen=True)
class Hints:
    """Everything known about the building in one photo; points are [N, 2] in working pixels.

    Attributes:
        positive, negative: the user's clicks.
        accepted, rejected: keypoints of sparse points that are, or are not, the building, as observed here.
        box: (x0, y0, x1, y1) around the accepted points (2nd to 98th percentile), or None.
        belief: float32 [H, W], probability of building from the models that all photos share.
    """

    positive: Points
    negative: Points
    accepted: Points
    rejected: Points
    box: tuple[float, float, float, float] | None
    belief: NDArray[np.float32]


@dataclass(frozen=True)
class Segment:
    """A mask of one photo: bool [H, W], and its agreement with the hints, 0..1."""

    mask: NDArray[np.bool_]
    score: float


class Segmenter(Protocol):
    """Draws the mask of the building in one photo."""

    name: str

    def segment(self, index: int, photo: NDArray[np.uint8], hints: Hints) -> Segment:
        """The mask of view ``index``, whose photo is RGB uint8 [H, W, 3]."""
        ...


def agreement(mask: NDArray[np.bool_], hints: Hints) -> float:
    """Share of the accepted points inside minus share of the rejected inside, 0..1 (clicks weigh like ten points).

    Without any point on either side that side says nothing; without any at all the answer is 0.
    """
    shares = []
    for points, clicks in ((hints.accepted, hints.positive), (hints.rejected, hints.negative)):
        weight = len(points) + 10 * len(clicks)
        if not weight:
            shares.append(None)
            continue
        shares.append((inside(mask, points).sum() + 10 * inside(mask, clicks).sum()) / weight)
    good, bad = shares
    if good is None:
        return 0.0
    return float(max(0.0, good - (bad or 0.0)))


def inside(mask: NDArray[np.bool_], points: Points) -> NDArray[np.bool_]:
    """Which points [N, 2] fall on the mask -> [N]."""
    x = np.clip(np.floor(points[:, 0]).astype(np.int64), 0, mask.shape[1] - 1)
    y = np.clip(np.floor(points[:, 1]).astype(np.int64), 0, mask.shape[0] - 1)
    return mask[y, x]
