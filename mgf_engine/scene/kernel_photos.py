# SPDX-License-Identifier: GPL-3.0-or-later
"""Hand photos to the matching kernels (struct Photo of ``csrc/stereo/correlate.h``)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mgf_engine.model.scene import View

_PHOTO = [*((name, "<i8") for name in ("quads", "depth", "height", "width")), ("to", "<f8", 12)]
#: Quads of a photo, its depth map or None, and its camera at that resolution.
KernelPhoto = tuple[NDArray[np.uint32], NDArray[np.float32] | None, View]


def photo_struct(first: View, photos: Sequence[KernelPhoto]) -> NDArray[np.void]:
    """Return photos with what takes the pixels of the first view to each.

    The arrays must be kept while the kernel runs: it is handed their addresses.
    """
    rows = [
        (quads.ctypes.data, 0 if depth is None else depth.ctypes.data, *quads.shape, pixel_transfer(first, view))
        for quads, depth, view in photos
    ]
    return np.array(rows, _PHOTO)


def pixel_transfer(first: View, second: View) -> NDArray[np.float64]:
    """Return M [3, 3] and b [3], flat [12]: a pixel (x, y) at a depth lies in the second photo at M (x, y, 1) + b /
    depth."""
    rotation = second.rotation @ first.rotation.T
    translation = second.translation - rotation @ first.translation
    to_second = second.intrinsics
    return np.concatenate([(to_second @ rotation @ np.linalg.inv(first.intrinsics)).ravel(), to_second @ translation])


def pack_quads(grey: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """Return the brightness of each pixel, and in the higher bytes of those right, below and below right, [h, w]."""
    padded = np.pad(grey, ((0, 1), (0, 1)), "edge")
    corners = padded[:-1, :-1], padded[:-1, 1:], padded[1:, :-1], padded[1:, 1:]
    return np.ascontiguousarray(np.stack(corners, -1)).view("<u4")[..., 0]
