# SPDX-License-Identifier: GPL-3.0-or-later
"""Find regions of sky, or of the plain backdrop behind a scale model.

A white wall resembles a white sky; but the sky extends to the top of the photo without an edge, and contains no sparse
points.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.components import label_components
from mgf_engine.masks.image_ops import color_distance, dilate, enlarge, erode, masked_mean
from mgf_engine.masks.propagation.superpixels import Superpixels
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class SkyOptions:
    """Options of sky detection; distances of colours are in CIELAB."""

    steps: tuple[float, float, float, float] = parameter(
        (8.0, 5.0, 3.0, 2.0),
        "Colour steps between regions that the sky may pass; the largest at which it stays free of points is taken",
    )
    smooth: float = parameter(1.0, "Maximum logarithm of the mean gradient of a region of sky")
    points_share: float = parameter(0.03, "Share of the usual density of sparse points above which a piece is no sky")
    smallest: float = parameter(0.004, "Minimum size of a piece of sky, as a share of the photo", high=1)
    large: float = parameter(
        0.03, "Size from which a piece of sky may contain one wrong point, as a share of the photo", high=1
    )
    top_share: float = parameter(0.02, "Share of the top edge of the photo that a piece of sky must touch", high=1)
    gradient_step: float = parameter(4.0, "Maximum colour distance of a region from the even change of a clear sky")
    gradient_spread: float = parameter(
        5.0, "Maximum colour distance of a region in a cloudy sky, as a factor of the median distance"
    )
    skyline_reach: float = parameter(
        0.016, "Distance from the sky in which the skyline is drawn, as a share of the longer side", high=1
    )
    skyline_steps: tuple[float, float] = parameter(
        (4.0, 12.0), "Bounds of the colour distance from the sky at which the skyline is drawn"
    )
    least_weight: float = parameter(1e-3, "Weight of a mean colour below which it is unknown")
    skyline_rounds: int = parameter(8, "Number of rounds in which the skyline may continue downwards")
    gap_contrast: float = parameter(
        20.0, "Minimum contrast between sky and building where the skyline continues downwards"
    )
    gap_step: float = parameter(6.0, "Maximum colour distance from the sky where the skyline continues downwards")


def find_sky(
    regions: Superpixels, observed: NDArray[np.int64], options: SkyOptions = SkyOptions()
) -> NDArray[np.int64]:
    """Label the connected piece of sky that each region belongs to, 0 for none, [S].

    Args:
        observed: regions in which this photo observed sparse points, once for each.
    """
    count = len(regions.area)
    points = np.bincount(observed, minlength=count)
    result = np.zeros(count, np.int64)
    for step in options.steps:
        piece = _pieces(regions, step, options)
        size = np.bincount(piece, regions.area)
        found = np.bincount(piece, points)
        touching = np.bincount(piece, regions.top)
        allowed = options.points_share * size * max(len(observed), 1) + (size > options.large)
        good = (size > options.smallest) & (touching > options.top_share) & (found <= allowed)
        new = good[piece] & (result == 0)
        result[new] = piece[new] + 1 + result.max()
    result[~_even(regions, result, options)] = 0
    return _with_rim(regions, result, points, options)


def draw_skyline(
    lab: NDArray[np.float32], mask: NDArray[np.bool_], sky: NDArray[np.bool_], options: SkyOptions = SkyOptions()
) -> NDArray[np.bool_]:
    """Refine the mask's edge against the sky to single pixels: superpixels are coarser than roof edges and chimneys.

    Args:
        lab: CIELAB [H, W, 3], see :func:`mgf_engine.masks.image_ops.rgb_to_lab`; mask: [H, W]; sky: [H, W],
            the regions that are sky.
        options: how like the sky a pixel must be, and how far from the mask's edge it is looked for.
    """
    if not (sky & ~mask).any():
        return mask
    near, like, clear = _like_sky(lab, mask, sky, 2 * options.skyline_steps[0], options.skyline_steps[1], options)
    # Half as far: at the horizon the land beside the building is near the sky, too.
    reach = _reach(mask, options)
    beside = cv2.dilate(mask.astype(np.uint8), np.ones((reach | 1, reach | 1), np.uint8)) > 0
    gap = near & ~like & beside & ~mask & _joined(mask | (near & ~like & beside), mask)
    drawn = mask & ~clear
    # Between two chimneys the sky reaches further down than any of its regions.
    for _ in range(options.skyline_rounds):
        sky = sky | (mask & ~drawn)
        further = drawn & _like_sky(lab, drawn, sky, options.gap_contrast, options.gap_step, options)[2]
        if not further.any():
            break
        drawn &= ~further
    return drawn | gap


def _reach(mask: NDArray[np.bool_], options: SkyOptions) -> int:
    return max(3, round(options.skyline_reach * max(mask.shape)))


def _like_sky(
    lab: NDArray[np.float32],
    mask: NDArray[np.bool_],
    sky: NDArray[np.bool_],
    least: float,
    step: float,
    options: SkyOptions,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return pixels near the sky, those like it, and those that are sky, [H, W] each.

    Args:
        least: contrast (CIELAB) between sky and building from which pixels of the mask may be sky.
        step: from the sky (CIELAB) up to which a pixel may be like it.
    """
    reach = _reach(mask, options)
    sure = cv2.erode((sky & ~mask).astype(np.uint8), np.ones((5, 5), np.uint8), borderValue=1) > 0
    if not sure.any():
        none = np.zeros_like(mask)
        return none, none, none
    above = masked_mean(lab, sure, 2.0 * reach)
    below = masked_mean(lab, erode(mask, reach), 2.0 * reach)
    known = below.weight > options.least_weight
    contrast = color_distance(above.color, below.color)
    most = np.where(
        known, np.clip(0.4 * contrast, options.skyline_steps[0], step), np.float32(options.skyline_steps[0])
    )
    like = color_distance(lab, enlarge(above.color, mask.shape)) < enlarge(most, mask.shape)
    near = dilate(sky, reach) & (enlarge(above.weight, mask.shape) > options.least_weight)
    clear = near & like & _joined(like & (near | sure), sure)
    # A wall as bright as the sky behind it cannot be told from it: there the regions know better.
    clear &= enlarge(((contrast > least) | ~known).astype(np.float32), mask.shape) > 0.5
    return near, like, clear


def _joined(mask: NDArray[np.bool_], seeds: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the pieces of a mask that hold a seed."""
    count, pieces = cv2.connectedComponents(mask.astype(np.uint8), connectivity=4)
    held = np.zeros(count, bool)
    held[pieces[seeds & mask]] = True
    held[0] = False
    return np.asarray(held[pieces], bool)


def _even(regions: Superpixels, sky: NDArray[np.int64], options: SkyOptions) -> NDArray[np.bool_]:
    """Return regions whose colour is what the sky around would have there; a pale roof is not, though no edge parts
    it."""
    result = np.ones(len(sky), bool)
    centres = regions.centres / np.maximum(regions.centres.max(0), 1e-6)
    x, y = centres.T
    basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], 1).astype(np.float64)
    for piece in np.unique(sky[sky > 0]):
        rows = np.flatnonzero(sky == piece)
        if len(rows) < 4 * basis.shape[1]:
            continue
        color, weight = regions.features[rows, :3].astype(np.float64), regions.area[rows].astype(np.float64)
        for _ in range(4):
            fit = np.linalg.lstsq(basis[rows] * weight[:, None], color * weight[:, None], rcond=None)[0]
            away = np.linalg.norm(color - basis[rows] @ fit, axis=1)
            scale = max(float(np.median(away)), 0.5)
            weight = regions.area[rows] / (1 + (away / (2 * scale)) ** 2)
        result[rows] = away < max(options.gradient_step, options.gradient_spread * scale)
    return result


def _with_rim(
    regions: Superpixels, sky: NDArray[np.int64], points: NDArray[np.int64], options: SkyOptions
) -> NDArray[np.int64]:
    """Return the pieces grown by regions of the same colour beside them: next to an edge no region is smooth."""
    result = sky.copy()
    a, b = np.concatenate([regions.pairs, regions.pairs[:, ::-1]]).T
    color = np.linalg.norm(regions.features[a, :3] - regions.features[b, :3], axis=1)
    joins = (sky[a] > 0) & (sky[b] == 0) & (color < options.steps[-1]) & (points[b] == 0)
    result[b[joins]] = sky[a[joins]]
    return result


def _pieces(regions: Superpixels, step: float, options: SkyOptions) -> NDArray[np.int64]:
    """Label the connected pieces of smooth regions without an edge between them, [S]."""
    smooth = regions.features[:, 3] <= options.smooth
    a, b = regions.pairs.T
    open_ = (regions.contrast <= step) & smooth[a] & smooth[b]
    return label_components(len(regions.area), a[open_], b[open_]).astype(np.int64)
