# SPDX-License-Identifier: GPL-3.0-or-later
"""Silhouettes of thin structures against the sky, pixel by pixel.

Open steelwork, railings and masts are thinner than superpixels and have no sparse points. But they stand out against
the sky. The silhouettes of several photos give their position in space
(:mod:`mgf_engine.masks.refinement.silhouette_hull`).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.geometry.elevation import over_horizon
from mgf_engine.masks.image_ops import color_distance, erode_square
from mgf_engine.model.scene import View
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class SilhouetteOptions:
    """Options of silhouettes against the sky."""

    sky_distance: float = parameter(
        5.0, "Colour distance (CIELAB) to the sky around below which a pixel is sky; twice that is something else"
    )
    sky_spread: float = parameter(1.5, "Minimum of sky_distance, as a multiple of the 95th percentile within the sky")
    shrink: int = parameter(4, "Factor by which the photo is reduced for the sky's colour, at least", low=1)
    reduced_side: int = parameter(190, "Longest side of the reduced photo", "px", low=16)
    widths: tuple[float, float] = parameter(
        (0.03, 0.1), "Widths of the means of the sky's colour, the second where the first finds none, share of the side"
    )
    horizon: float = parameter(1.5, "Elevation from which nothing can be ground", "degrees", low=-90, high=90)


@dataclass(frozen=True)
class SkySilhouette:
    """One photo over the horizon, bool [H, W] each: certain sky, and what certainly is not sky."""

    empty: NDArray[np.bool_]
    solid: NDArray[np.bool_]


def find_silhouette(
    lab: NDArray[np.float32],
    sky: NDArray[np.bool_],
    view: View,
    up: NDArray[np.float64],
    options: SilhouetteOptions = SilhouetteOptions(),
) -> SkySilhouette:
    """Tell sky from what stands before it, over the horizon of the photo.

    Args:
        lab: CIELAB [H, W, 3], see :func:`mgf_engine.masks.image_ops.rgb_to_lab`; sky: [H, W], regions that are
            sky; up: [3], normalised frame.
        view: camera of the photo.
        options: elevation above which silhouettes are found, and colour distances of the sky and of what is before it.
    """
    over = over_horizon(view, up, options.horizon)
    sure = erode_square(sky, 2)
    if not (sure & over).any():
        return SkySilhouette(np.zeros_like(sky), np.zeros_like(sky))
    around, known = _sky_around(lab, sure, options)
    away = color_distance(lab, around)
    most = max(options.sky_distance, options.sky_spread * float(np.percentile(away[sure], 95)))
    return SkySilhouette(over & known & (away < most), over & known & (away > 2 * most))


def _sky_around(
    lab: NDArray[np.float32], sure: NDArray[np.bool_], options: SilhouetteOptions
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the colour of the sky around each pixel [H, W, 3], and where there is any, [H, W]."""
    height, width = sure.shape
    factor = max(options.shrink, max(height, width) // options.reduced_side)
    size = (max(1, width // factor), max(1, height // factor))
    weight = cv2.resize(sure.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    color = cv2.resize(lab * sure[..., None], size, interpolation=cv2.INTER_AREA)
    mean, total = np.zeros_like(color), np.zeros_like(weight)
    for share in options.widths:
        sigma = max(1.0, share * max(size))
        near = cv2.GaussianBlur(weight, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
        new = (total <= 1e-3) & (near > 1e-3)
        blurred = cv2.GaussianBlur(color, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
        mean[new] = (blurred / np.maximum(near, 1e-6)[..., None])[new]
        total[new] = near[new]
    wide = cv2.resize(mean, (width, height), interpolation=cv2.INTER_LINEAR)
    known = cv2.resize((total > 1e-3).astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST) > 0
    return np.asarray(wide, np.float32), known
