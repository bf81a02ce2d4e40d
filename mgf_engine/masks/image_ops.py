# SPDX-License-Identifier: GPL-3.0-or-later
"""CIELAB and colour distances, masked Gaussian blur, dilation and erosion of masks.

The cost does not depend on the radius: a wide Gaussian blur is computed on a reduced image, dilation and erosion with
discs by a distance transform.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

#: The standard deviation of a blur on the reduced photo, in its pixels.
SMALL_SIGMA = 6.0
#: A disc holds the pixels this much farther from its centre than its radius: half pixels at the rim count.
DISC_MARGIN = 0.3


def rgb_to_lab(photo: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Convert a photo, RGB uint8 [H, W, 3], to CIELAB: lightness 0..100, green to red, blue to yellow; float32."""
    return np.asarray(cv2.cvtColor(photo.astype(np.float32) / 255, cv2.COLOR_RGB2LAB), np.float32)


@dataclass(frozen=True)
class MaskedMean:
    """Masked Gaussian mean of colours at each pixel of a reduced photo.

    Attributes:
        color: float32 [h, w, 3]; unreliable where ``weight`` is nearly 0.
        weight: blurred mask, 0..1, float32 [h, w].
    """

    color: NDArray[np.float32]
    weight: NDArray[np.float32]


def masked_mean(colors: NDArray[np.float32], where: NDArray[np.bool_], sigma: float) -> MaskedMean:
    """Compute the Gaussian mean of the colours of some pixels around every pixel.

    Args:
        colors: float32 [H, W, 3].
        where: [H, W], the pixels that count.
        sigma: standard deviation in pixels.
    """
    factor = max(1, int(sigma / SMALL_SIGMA))
    height, width = where.shape
    size = (-(-width // factor), -(-height // factor))
    marked = where.astype(np.uint8)
    color = _blurred(cv2.copyTo(colors, marked), size, sigma)
    weight = _blurred(marked.astype(np.float32), size, sigma)
    mean = color / np.maximum(weight, np.float32(1e-6))[..., None]
    return MaskedMean(np.asarray(mean, np.float32), weight)


def _blurred(values: NDArray[Any], size: tuple[int, int], sigma: float) -> NDArray[np.float32]:
    """Return the values of all pixels, blurred, on a photo reduced to another width and height; ``sigma`` is in whole
    pixels."""
    height, width = values.shape[:2]
    small = cv2.resize(values, size, interpolation=cv2.INTER_AREA)
    # Mirrored at the frame itself, which is where the whole photo is mirrored but for half a pixel.
    sigmas = (sigma * size[0] / width, sigma * size[1] / height)
    return np.asarray(cv2.GaussianBlur(small, (0, 0), *sigmas, borderType=cv2.BORDER_REFLECT), np.float32)


def enlarge(values: NDArray[np.float32], shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return values of a reduced photo at every pixel of the whole one, [H, W] or [H, W, C]."""
    return np.asarray(cv2.resize(values, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR), np.float32)


def color_distance(first: NDArray[np.float32], second: NDArray[np.float32]) -> NDArray[np.float32]:
    """Compute the Euclidean distance of the colours of two pictures, pixel by pixel; float32 [H, W, 3] each ->
    [H, W]."""
    away = cv2.subtract(first, second)
    squares = cv2.transform(cv2.multiply(away, away), np.ones((1, 3), np.float32))
    return np.asarray(cv2.sqrt(squares), np.float32)


def dilate(mask: NDArray[np.bool_], radius: int) -> NDArray[np.bool_]:
    """Dilate a mask [H, W] with a disc."""
    if not mask.any():
        return np.zeros_like(mask)
    return np.asarray(_distance(~mask) <= radius + DISC_MARGIN, bool)


def erode(mask: NDArray[np.bool_], radius: int) -> NDArray[np.bool_]:
    """Erode a mask [H, W] with a disc; the frame of the photo does not erode it."""
    if mask.all():
        return np.ones_like(mask)
    return np.asarray(_distance(mask) > radius + DISC_MARGIN, bool)


def _distance(mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the distance of the mask's pixels to the nearest other pixel."""
    return np.asarray(cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5), np.float32)


def dilate_square(mask: NDArray[np.bool_], radius: int) -> NDArray[np.bool_]:
    """Dilate a mask [H, W] with a square of 2 radius + 1 px."""
    return np.asarray(cv2.dilate(mask.astype(np.uint8), _square(radius)) > 0, bool)


def erode_square(mask: NDArray[np.bool_], radius: int) -> NDArray[np.bool_]:
    """Erode a mask [H, W] with a square of 2 radius + 1 px; the frame of the photo does not erode it."""
    return np.asarray(cv2.erode(mask.astype(np.uint8), _square(radius), borderValue=1) > 0, bool)


def _square(radius: int) -> NDArray[np.uint8]:
    return np.ones((2 * radius + 1,) * 2, np.uint8)


def disc(radius: int) -> NDArray[np.uint8]:
    """Return the structuring element of a disc, [2 radius + 1, 2 radius + 1]."""
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1)), np.uint8)


def fill_mask_holes(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Fill the holes of a mask, such as a white wall between its edges."""
    _, labels = cv2.connectedComponents((~mask).astype(np.uint8), connectivity=4)
    outer = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    return mask | ~np.isin(labels, outer)
