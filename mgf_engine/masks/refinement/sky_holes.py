# SPDX-License-Identifier: GPL-3.0-or-later
"""Sky that shows through the building: between the bars of a frame, under an arch, through an open belfry.

A mask is drawn around such parts as a whole. Called building, the air between the bars would be filled.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from mgf_engine.masks.image_ops import distance, enlarge, masked_mean
from mgf_engine.masks.points import pixel_at
from mgf_engine.masks.refinement.sky_silhouette import OVER_HORIZON, outline, over_horizon
from mgf_engine.model.scene import View

#: CIELAB distance between the sky and the building around a gap; a wall as pale as the sky is no gap.
CONTRAST = 20.0
#: Degrees over the horizon down to which sky is looked for, and the share of a piece that may lie below it all the
#: same: a pale column reaches down to its foot.
HORIZON, FOOT = 0.0, 0.05
SMALLEST = 6  # px
#: Share of the building below the horizon, where no sky is, that may have its colour: beyond, colour proves nothing.
PALE = 0.03
BIN = 4.0  # CIELAB; colours of the sky are counted in bins of this side
#: Points that a gap may hold all the same (features between bars), or such a share of what as much building holds.
FEW_POINTS, CROWDED = 1, 0.5
#: px: a point so near to the edge of a gap is a corner of what is around it, if the gap has so many pixels farther in.
RIM, DEEP = 3, 30
AROUND = 0.03  # share of the longer side: the building around a gap


def sky_through(
    lab: NDArray[np.float32],
    mask: NDArray[np.bool_],
    sky: NDArray[np.bool_],
    view: View,
    up: NDArray[np.float64],
    points: NDArray[np.floating],
) -> NDArray[np.bool_]:
    """Pixels that are sky behind the building, [H, W].

    Args:
        lab: CIELAB [H, W, 3], see :func:`lab_of`.
        mask: [H, W], where the building is or may be; sky: [H, W], regions that are sky.
        up: [3], normalised frame.
        points: [N, 2], pixels in which this photo observed sparse points: a window that mirrors the sky has as many as
            the wall around it.
    """
    none = np.zeros_like(mask)
    if not sky.any():
        return none
    seen = outline(lab, sky, view, up, degrees=-90)
    over, under = over_horizon(view, up, HORIZON), ~over_horizon(view, up, -OVER_HORIZON)
    gaps = seen.empty & mask
    if not (gaps & over).any():
        return none
    clear = cv2.erode((sky & ~mask).astype(np.uint8), np.ones((9, 9), np.uint8), borderValue=1) > 0
    if _pale(lab, mask & under, clear & over_horizon(view, up)) > PALE:
        return none
    count, pieces, stats, _ = cv2.connectedComponentsWithStats(gaps.astype(np.uint8), connectivity=4)
    good = stats[:, cv2.CC_STAT_AREA] >= SMALLEST
    good &= np.bincount(pieces[gaps & under], minlength=count) <= FOOT * stats[:, cv2.CC_STAT_AREA]
    y, x = pixel_at(mask.shape, points)
    counting = _counting(gaps, pieces, count)
    inside = np.bincount(pieces[y, x][counting[y, x]], minlength=count)
    usual = mask[y, x].sum() / max(int(mask.sum()), 1)
    good &= inside <= np.maximum(FEW_POINTS, CROWDED * usual * np.bincount(pieces[counting], minlength=count))
    good &= _contrasts(lab, gaps, mask & seen.solid, pieces, count) > CONTRAST
    good[0] = False
    return np.asarray(good[pieces] & over, bool)


def _counting(gaps: NDArray[np.bool_], pieces: NDArray[Any], count: int) -> NDArray[np.bool_]:
    """Erode a piece to where points count, off its edge, bool [H, W]; all of it where hardly anything is left."""
    deep = cv2.erode(gaps.astype(np.uint8), np.ones((2 * RIM + 1,) * 2, np.uint8), borderValue=1) > 0
    large = np.bincount(pieces[deep], minlength=count) >= DEEP
    return np.asarray(gaps & (deep | ~large[pieces]), bool)


def _pale(lab: NDArray[np.float32], body: NDArray[np.bool_], sky: NDArray[np.bool_]) -> float:
    """Share of the pixels of ``body`` that have a colour of the sky, give or take a bin."""
    size = int(256 / BIN)

    def places(where: NDArray[np.bool_]) -> tuple[NDArray[np.uint8], ...]:
        bins = (lab[where] + np.array([0, 128, 128], np.float32)) / BIN
        return tuple(np.clip(bins, 0, size - 1).astype(np.uint8).T)

    known = np.zeros((size,) * 3, np.uint8)
    known[places(sky)] = 1
    grown = maximum_filter(known, 3)
    return float(grown[places(body)].mean()) if body.any() else 0.0


def _contrasts(
    lab: NDArray[np.float32], gaps: NDArray[np.bool_], body: NDArray[np.bool_], pieces: NDArray[Any], count: int
) -> NDArray[np.float64]:
    """CIELAB distance between the mean colour of each piece and that of the building around it, [count]."""
    around = masked_mean(lab, body, AROUND * max(body.shape))
    away = distance(lab, enlarge(around.colour, body.shape)) * (enlarge(around.weight, body.shape) > 1e-3)
    sums = np.bincount(pieces[gaps], away[gaps], minlength=count)
    return np.asarray(sums / np.maximum(np.bincount(pieces[gaps], minlength=count), 1), np.float64)
