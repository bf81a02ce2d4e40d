# SPDX-License-Identifier: GPL-3.0-or-later
"""Find sky visible through the building: between bars, under an arch, through an open belfry.

The masks are drawn around such parts as a whole; without this step the gaps would be reconstructed as solid.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from mgf_engine.masks.geometry.elevation import over_horizon
from mgf_engine.masks.image_ops import color_distance, enlarge, erode_square, masked_mean
from mgf_engine.masks.refinement.sky_silhouette import SilhouetteOptions, find_silhouette
from mgf_engine.model.pixels import pixel_at
from mgf_engine.model.scene import View
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class SkyHoleOptions:
    """Options of sky that shows through the building; distances of colours are in CIELAB."""

    contrast: float = parameter(20.0, "Minimum colour distance between the sky and the building around a hole")
    horizon: float = parameter(0.0, "Elevation above which sky is sought", "degrees", low=-90)
    below_share: float = parameter(0.05, "Share of a hole that may lie below the horizon", high=1)
    smallest: int = parameter(6, "Minimum area of a hole", "px²")
    pale: float = parameter(
        0.03,
        "Share of the building below the horizon with the colour of the sky beyond which colour proves nothing",
        high=1,
    )
    bin: float = parameter(4.0, "Side of the bins in which colours of the sky are counted", low=1)
    few_points: int = parameter(1, "Number of sparse points that a hole may hold")
    crowded: float = parameter(0.5, "Share of the usual density of sparse points that a hole may hold")
    rim: int = parameter(3, "Distance from the edge of a hole within which points belong to what is around it", "px")
    deep: int = parameter(30, "Minimum area of a hole without that rim for points to be counted there alone", "px²")
    around: float = parameter(
        0.03, "Radius of the building around a hole, as a share of the longer side", low=1e-4, high=1
    )
    silhouette: SilhouetteOptions = SilhouetteOptions()


def find_sky_holes(
    lab: NDArray[np.float32],
    mask: NDArray[np.bool_],
    sky: NDArray[np.bool_],
    view: View,
    up: NDArray[np.float64],
    points: NDArray[np.floating],
    options: SkyHoleOptions = SkyHoleOptions(),
) -> NDArray[np.bool_]:
    """Find pixels that are sky behind the building, [H, W].

    Args:
        lab: CIELAB [H, W, 3], see :func:`mgf_engine.masks.image_ops.rgb_to_lab`.
        mask: [H, W], where the building is or may be; sky: [H, W], regions that are sky.
        view: camera of the photo.
        up: [3], normalised frame.
        points: [N, 2], pixels in which this photo observed sparse points: a window that mirrors the sky has as many as
            the wall around it.
        options: size and colour of a hole.
    """
    none = np.zeros_like(mask)
    if not sky.any():
        return none
    seen = find_silhouette(lab, sky, view, up, replace(options.silhouette, horizon=-90.0))
    horizon = options.silhouette.horizon
    over, under = over_horizon(view, up, options.horizon), ~over_horizon(view, up, -horizon)
    gaps = seen.empty & mask
    if not (gaps & over).any():
        return none
    clear = erode_square(sky & ~mask, 4)
    if _pale(lab, mask & under, clear & over_horizon(view, up, horizon), options) > options.pale:
        return none
    count, pieces, stats, _ = cv2.connectedComponentsWithStats(gaps.astype(np.uint8), connectivity=4)
    good = stats[:, cv2.CC_STAT_AREA] >= options.smallest
    good &= np.bincount(pieces[gaps & under], minlength=count) <= options.below_share * stats[:, cv2.CC_STAT_AREA]
    y, x = pixel_at(mask.shape, points)
    counting = _counting(gaps, pieces, count, options)
    inside = np.bincount(pieces[y, x][counting[y, x]], minlength=count)
    usual = mask[y, x].sum() / max(int(mask.sum()), 1)
    good &= inside <= np.maximum(
        options.few_points, options.crowded * usual * np.bincount(pieces[counting], minlength=count)
    )
    good &= _contrasts(lab, gaps, mask & seen.solid, pieces, count, options) > options.contrast
    good[0] = False
    return np.asarray(good[pieces] & over, bool)


def _counting(gaps: NDArray[np.bool_], pieces: NDArray[Any], count: int, options: SkyHoleOptions) -> NDArray[np.bool_]:
    """Erode a piece to where points count, off its edge, bool [H, W]; all of it where hardly anything is left."""
    deep = erode_square(gaps, options.rim)
    large = np.bincount(pieces[deep], minlength=count) >= options.deep
    return np.asarray(gaps & (deep | ~large[pieces]), bool)


def _pale(lab: NDArray[np.float32], body: NDArray[np.bool_], sky: NDArray[np.bool_], options: SkyHoleOptions) -> float:
    """Return the share of the pixels of ``body`` that have a colour of the sky, give or take a bin."""
    size = int(256 / options.bin)

    def places(where: NDArray[np.bool_]) -> tuple[NDArray[np.uint8], ...]:
        bins = (lab[where] + np.array([0, 128, 128], np.float32)) / options.bin
        return tuple(np.clip(bins, 0, size - 1).astype(np.uint8).T)

    known = np.zeros((size,) * 3, np.uint8)
    known[places(sky)] = 1
    grown = maximum_filter(known, 3)
    return float(grown[places(body)].mean()) if body.any() else 0.0


def _contrasts(
    lab: NDArray[np.float32],
    gaps: NDArray[np.bool_],
    body: NDArray[np.bool_],
    pieces: NDArray[Any],
    count: int,
    options: SkyHoleOptions,
) -> NDArray[np.float64]:
    """Return CIELAB distance between the mean colour of each piece and that of the building around it, [count]."""
    around = masked_mean(lab, body, options.around * max(body.shape))
    away = color_distance(lab, enlarge(around.color, body.shape)) * (enlarge(around.weight, body.shape) > 1e-3)
    sums = np.bincount(pieces[gaps], away[gaps], minlength=count)
    return np.asarray(sums / np.maximum(np.bincount(pieces[gaps], minlength=count), 1), np.float64)
