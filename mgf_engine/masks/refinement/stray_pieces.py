# SPDX-License-Identifier: GPL-3.0-or-later
"""Find stray components of a mask: without clicks and sparse points, and outside of the building's extent."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.model.pixels import pixel_at


def find_stray_pieces(
    mask: NDArray[np.bool_], core: NDArray[np.bool_], known: NDArray[np.floating], least_cover: float
) -> NDArray[np.bool_]:
    """Find the stray pieces of a mask, [H, W]; none where no piece holds a known pixel.

    Args:
        mask: of the building, [H, W].
        core: where rays meet the building's surface in space, [H, W].
        known: pixels on the building, by clicks and sparse points, [N, 2].
        least_cover: share of a piece's area in ``core`` below which it is stray.
    """
    _, pieces, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    covered = np.bincount(pieces[core], minlength=len(stats)) / np.maximum(stats[:, cv2.CC_STAT_AREA], 1)
    holds = np.bincount(pieces[pixel_at(mask.shape, known)], minlength=len(stats)) > 0
    stray = ~holds & (covered < least_cover)
    stray[0] = False
    return np.asarray(stray[pieces] if holds[1:].any() else np.zeros_like(mask), bool)
