# SPDX-License-Identifier: GPL-3.0-or-later
"""Multi-scale SSIM of masks (Wang, Simoncelli and Bovik 2003): its scales, and value and slope from pooled sums."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Exponents of multi-scale SSIM (Wang, Simoncelli and Bovik 2003), finest scale first.
MS_SSIM_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)


WINDOW = 11


FLOOR = 0.01  # pooled similarity is kept positive so that its powers have a slope


def scales_of(area: NDArray[np.int64], height: int, width: int) -> int:
    """Return the number of scales of MS-SSIM: of the largest mask's area, 11 px wide or more at each; area [ids]."""
    largest = int(area.max(initial=0))
    fitting = int(np.floor(np.log2(max(np.sqrt(largest) / WINDOW, 1.0)))) + 1
    return min(len(MS_SSIM_WEIGHTS), fitting, int(np.log2(min(height, width))) + 1)


def ms_ssim(sums: NDArray[np.float64], area: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return multi-scale SSIM of each mask, and its slope in every pixel's similarity and contrast-structure.

    A mask takes part at a scale while a square of its area is at least one window wide there; exponents of the scales
    it takes part in are scaled to sum to one. Masks below 11 px are 1 and have no slope.

    Args:
        sums: [scales, 2, ids], both maps summed over each mask.
        area: [scales or more, ids], pixels of each mask.

    Returns:
        [ids] and [scales, 2, ids].
    """
    scales = len(sums)
    area = area[:scales]
    takes_part = np.sqrt(area[0])[None] >= WINDOW * 2.0 ** np.arange(scales)[:, None]
    share = np.array(MS_SSIM_WEIGHTS[:scales])[:, None] * takes_part
    share /= np.maximum(share.sum(0), 1e-9)
    kind = np.where(takes_part.sum(0) - 1 == np.arange(scales)[:, None], 0, 1)[:, None]  # similarity at its last scale
    mean = np.take_along_axis(sums, kind, 1)[:, 0] / np.maximum(area, 1)
    mean[area == 0] = 1.0
    kept = np.maximum(mean, FLOOR)
    value = np.exp((share * np.log(kept)).sum(0))
    slope = np.where((mean >= FLOOR) & (area > 0), value * share / (kept * np.maximum(area, 1)), 0.0)
    slopes = np.zeros_like(sums)
    np.put_along_axis(slopes, kind, slope[:, None], 1)
    return value, slopes
