# SPDX-License-Identifier: GPL-3.0-or-later
"""Boundaries of label maps and the pixel weights made from them (eq. 12).

A pixel lies on a boundary when one of its four neighbours has another label. (The paper's convolution with an
edge kernel can cancel on label values: 1, 2, 3 in a row gives zero.) The frame of the photo is no boundary, the
outline of the building is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mgf_engine.model.masks import building


def boundaries(labels: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Find the pixels with a 4-neighbour of another label, ``M_bd`` of eq. 12; labels [H, W] -> bool [H, W]."""
    result = np.zeros(labels.shape, bool)
    vertical, horizontal = labels[1:] != labels[:-1], labels[:, 1:] != labels[:, :-1]
    result[1:] |= vertical
    result[:-1] |= vertical
    result[:, 1:] |= horizontal
    result[:, :-1] |= horizontal
    return result


def weights(labels: NDArray[np.uint8], w_edge: float) -> NDArray[np.float32]:
    """Return w(u, v) of eq. 12: ``w_edge`` on the building's boundaries, 1 elsewhere on it, 0 outside.

    Args:
        labels: [H, W], see :mod:`mgf_engine.model.masks`.
        w_edge: at least 1; 10 in the paper.

    Returns:
        float32 [H, W].
    """
    inside = building(labels)
    return np.where(inside, np.where(boundaries(labels), w_edge, 1.0), 0.0).astype(np.float32)
