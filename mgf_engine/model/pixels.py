# SPDX-License-Identifier: GPL-3.0-or-later
"""Look up and interpolate a picture at positions; the centre of the top-left pixel is (0.5, 0.5)."""

from __future__ import annotations

from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

Value = TypeVar("Value", np.uint8, np.float32)
_COLUMNS = 4096  # of positions that are interpolated at once; OpenCV takes fewer than 32,768 columns and rows


def pixel_at(shape: tuple[int, ...], uv: NDArray[np.floating]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return rows and columns [N] of the pixels that positions (u, v) [N, 2] lie in, clamped to a picture's shape."""
    column = np.clip(np.floor(uv[:, 0]).astype(np.int64), 0, shape[1] - 1)
    row = np.clip(np.floor(uv[:, 1]).astype(np.int64), 0, shape[0] - 1)
    return row, column


def sample_pixels(
    image: NDArray[Value], uv: NDArray[np.float64], interpolation: int = cv2.INTER_LINEAR
) -> NDArray[Value]:
    """Interpolate a picture at positions (u, v) [N, 2], clamped at its edge.

    Args:
        image: [H, W] or [H, W, C].
        uv: positions; NaN is the top-left corner.
        interpolation: of OpenCV.

    Returns:
        [N] or [N, C].
    """
    rows = max(1, -(-len(uv) // _COLUMNS))
    maps = np.zeros((rows * _COLUMNS, 2), np.float32)
    maps[: len(uv)] = np.nan_to_num(uv - 0.5, nan=-1.0)
    x, y = (np.ascontiguousarray(maps[:, k]).reshape(rows, _COLUMNS) for k in range(2))
    found = cv2.remap(image, x, y, interpolation=interpolation, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found.reshape(-1, *image.shape[2:])[: len(uv)], image.dtype)
