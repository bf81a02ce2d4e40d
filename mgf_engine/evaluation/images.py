# SPDX-License-Identifier: GPL-3.0-or-later
"""Image metrics of a rendered view against its photo, inside the building's mask (eq. 27-29).

Two ways of pooling are given. *Inside the mask* (``psnr``, ``ssim``) averages over mask pixels only: it does not depend
on how much of the frame the building fills. *Whole frame* (``psnr_frame``, ``ssim_frame``) is the paper's convention:
everything outside the mask is set to zero in both pictures, and the mean runs over the frame, so that the outside
counts as perfect. Figures of the two must not be compared with each other.

LPIPS (eq. 29) needs a network's weights (:mod:`mgf_engine.evaluation.lpips`) and is None without. ``lpips`` is of the
mask's box, ``lpips_frame`` of the whole frame; what is outside the mask is zero in both pictures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.evaluation.lpips import MIN_SIDE, Lpips

#: PSNR of pictures that are equal (the true value is infinite, which JSON cannot say).
PSNR_LIMIT = 100.0
_WINDOW, _SIGMA = 11, 1.5
_C1, _C2 = 0.01**2, 0.03**2


@dataclass(frozen=True)
class Scores:
    """Scores of one view; ``None`` where there is nothing to measure.

    Attributes:
        psnr: dB, over the pixels of the mask (eq. 27).
        ssim: mean over the pixels of the mask (eq. 28).
        psnr_frame, ssim_frame: over the whole frame, outside set to zero in both pictures.
        lpips, lpips_frame: see the module.
        pixels: number of mask pixels.
    """

    psnr: float | None
    ssim: float | None
    psnr_frame: float | None
    ssim_frame: float | None
    lpips: float | None
    lpips_frame: float | None
    pixels: int


def score(
    photo: NDArray[np.uint8], render: NDArray[np.uint8], mask: NDArray[np.bool_], lpips: Lpips | None = None
) -> Scores:
    """Compare a render with its photo.

    Args:
        photo, render: RGB uint8 [h, w, 3].
        mask: bool [h, w], the building (see :func:`mgf_engine.model.masks.building`).
        lpips: what measures LPIPS.

    Raises:
        ValueError: the shapes differ.
    """
    if photo.shape != render.shape or photo.shape[:2] != mask.shape:
        raise ValueError(f"shapes differ: photo {photo.shape}, render {render.shape}, mask {mask.shape}")
    pixels = int(mask.sum())
    if pixels == 0:
        return Scores(None, None, None, None, None, None, 0)
    masked = [np.where(mask[..., None], picture, 0).astype(np.uint8) for picture in (photo, render)]
    a, b = (picture / 255.0 for picture in masked)
    similarity = ssim_map(a, b)
    squared = ((a - b) ** 2).mean(-1)
    return Scores(
        psnr=_decibels(float(squared[mask].mean())), ssim=float(similarity[mask].mean()),
        psnr_frame=_decibels(float(squared.mean())), ssim_frame=float(similarity.mean()),
        lpips=None if lpips is None else lpips.distance(*(p[_box(mask)] for p in masked)),
        lpips_frame=None if lpips is None else lpips.distance(*masked), pixels=pixels,
    )  # fmt: skip


def _box(mask: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Return the mask's box, widened where a network would find it too small and the frame has room."""
    sides = []
    for axis, size in enumerate(mask.shape):
        there = np.flatnonzero(mask.any(1 - axis))
        low, high = int(there[0]), int(there[-1]) + 1
        missing = max(0, MIN_SIDE - (high - low))
        low = max(0, min(low - missing // 2, size - MIN_SIDE))
        sides.append(slice(low, min(size, max(high, low + MIN_SIDE))))
    return sides[0], sides[1]


def mean_scores(scores: list[Scores]) -> Scores:
    """Return the mean of each score over the views that have it (views count alike, as in the literature)."""

    def mean(name: str) -> float | None:
        values = [value for s in scores if (value := getattr(s, name)) is not None]
        return float(np.mean(values)) if values else None

    means = {name: mean(name) for name in ("psnr", "ssim", "psnr_frame", "ssim_frame", "lpips", "lpips_frame")}
    return Scores(**means, pixels=sum(s.pixels for s in scores))


def ssim_map(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute eq. 28 at every pixel, in a Gaussian window of 11 x 11 with sigma 1.5, averaged over the channels.

    Args:
        a, b: float64 [h, w, 3] in 0..1.

    Returns:
        [h, w], 1 where the windows are equal; at the frame's edge the window is mirrored.
    """
    mean_a, mean_b = _blur(a), _blur(b)
    # Variances are means of squares minus squared means; rounding can make them minutely negative.
    var_a = np.maximum(_blur(a * a) - mean_a**2, 0.0)
    var_b = np.maximum(_blur(b * b) - mean_b**2, 0.0)
    covariance = _blur(a * b) - mean_a * mean_b
    top = (2 * mean_a * mean_b + _C1) * (2 * covariance + _C2)
    bottom = (mean_a**2 + mean_b**2 + _C1) * (var_a + var_b + _C2)
    return (top / bottom).mean(-1)


def _blur(image: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(cv2.GaussianBlur(image, (_WINDOW, _WINDOW), _SIGMA, borderType=cv2.BORDER_REFLECT_101))


def _decibels(mse: float) -> float:
    """Compute eq. 27 with MAX = 1."""
    return PSNR_LIMIT if mse <= 0.0 else min(PSNR_LIMIT, -10.0 * math.log10(mse))
