# SPDX-License-Identifier: GPL-3.0-or-later
"""Boundaries of label maps, M_bd of eq. 12; :mod:`mgf_engine.field.targets` weights their pixels.

A pixel lies on a boundary if one of its four neighbours has another label. (The paper's convolution with an edge
kernel can cancel: labels 1, 2, 3 in a row give zero.) The outline of the building is a boundary, the frame of the photo
is not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def boundaries(labels: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Find the pixels with a 4-neighbour of another label, ``M_bd`` of eq. 12; labels [H, W] -> bool [H, W]."""
    result = np.zeros(labels.shape, bool)
    vertical, horizontal = labels[1:] != labels[:-1], labels[:, 1:] != labels[:, :-1]
    result[1:] |= vertical
    result[:-1] |= vertical
    result[:, 1:] |= horizontal
    result[:, :-1] |= horizontal
    return result
