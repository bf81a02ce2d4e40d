# SPDX-License-Identifier: GPL-3.0-or-later
"""Sky that shows through the building: between the bars of a frame, under an arch, through an open belfry.

A mask is drawn around such parts as a whole. Called building, the air between the bars would be filled.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.silhouette import outline
from mgf_engine.scene.model import View

#: CIELAB distance between the sky and the building around a gap; a wall as pale as the sky is no gap.
CONTRAST = 20.0
SMALLEST = 6  # px
#: Points that a gap may hold all the same (features between bars), or such a share of what as much building holds.
FEW_POINTS, CROWDED = 1, 0.5
AROUND = 0.03  # share of the longer side: the building around a gap


def sky_through(
    photo: NDArray[np.uint8],
    mask: NDArray[np.bool_],
    sky: NDArray[np.bool_],
    view: View,
    up: NDArray[np.float64],
    points: NDArray[np.floating],
) -> NDArray[np.bool_]:
    """Pixels of a mask that are sky behind the building, [H, W].

    Args:
        photo: RGB uint8 [H, W, 3]; mask: [H, W], the building; sky: [H, W], regions that are sky.
        up: [3], normalised frame.
        points: [N, 2], pixels in which this photo observed sparse points: a window that mirrors the sky has as many as
            the wall around it.
    """
    none = np.zeros_like(mask)
    if not sky.any():
        return none
    seen = outline(photo, sky, view, up)
    gaps = seen.empty & mask
    if not gaps.any():
        return none
    count, pieces, stats, _ = cv2.connectedComponentsWithStats(gaps.astype(np.uint8), connectivity=4)
    good = stats[:, cv2.CC_STAT_AREA] >= SMALLEST
    x, y = np.clip(np.floor(points).astype(np.int64), 0, np.array(mask.shape[::-1]) - 1).T
    inside = np.bincount(pieces[y, x][gaps[y, x]], minlength=count)
    usual = mask[y, x].sum() / max(int(mask.sum()), 1)
    good &= inside <= np.maximum(FEW_POINTS, CROWDED * usual * stats[:, cv2.CC_STAT_AREA])
    good &= _contrasts(photo, gaps, mask & seen.solid, pieces, count) > CONTRAST
    good[0] = False
    return np.asarray(good[pieces], bool)


def _contrasts(
    photo: NDArray[np.uint8], gaps: NDArray[np.bool_], body: NDArray[np.bool_], pieces: NDArray[Any], count: int
) -> NDArray[np.float64]:
    """CIELAB distance between the mean colour of each piece and that of the building around it, [count]."""
    lab = np.asarray(cv2.cvtColor(photo.astype(np.float32) / 255, cv2.COLOR_RGB2LAB), np.float32)
    sigma = AROUND * max(body.shape)
    weight = cv2.GaussianBlur(body.astype(np.float32), (0, 0), sigma)
    colour = cv2.GaussianBlur(lab * body[..., None], (0, 0), sigma) / np.maximum(weight, 1e-4)[..., None]
    away = np.where(weight > 1e-3, np.linalg.norm(lab - colour, axis=2), 0.0)
    sums = np.bincount(pieces[gaps], away[gaps], minlength=count)
    return np.asarray(sums / np.maximum(np.bincount(pieces[gaps], minlength=count), 1), np.float64)
