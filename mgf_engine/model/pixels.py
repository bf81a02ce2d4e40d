# SPDX-License-Identifier: GPL-3.0-or-later
"""Look up the pixels of a picture that positions lie in; the centre of the top-left pixel is (0.5, 0.5)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def pixel_at(shape: tuple[int, ...], uv: NDArray[np.floating]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return rows and columns [N] of the pixels that positions (u, v) [N, 2] lie in, clamped to a picture's shape."""
    column = np.clip(np.floor(uv[:, 0]).astype(np.int64), 0, shape[1] - 1)
    row = np.clip(np.floor(uv[:, 1]).astype(np.int64), 0, shape[0] - 1)
    return row, column
