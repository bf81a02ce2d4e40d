# SPDX-License-Identifier: GPL-3.0-or-later
"""Normalised cross-correlation of each pixel's patch with other photos; the best of them count."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.native.library import call

Map = NDArray[np.float32]

PATCH = 5  # px, the side; the kernel's, too


class Patches:
    """A photo's patches, ready to be compared with others: uint8 CIELAB [h, w, 3].

    The comparison itself is ``csrc/stereo/compare_patches.c``.

    Args:
        lab: of the photo.
        texture: variance of the lightness below which a patch cannot be compared.
    """

    def __init__(self, lab: NDArray[np.uint8], texture: float = 0.5) -> None:
        self.texture = texture
        self.lightness = lab[..., 0].astype(np.float32) * np.float32(100 / 255)
        self.average = _mean(self.lightness)
        self.variance = _mean(self.lightness**2) - self.average**2
        self.smooth = np.stack(cv2.split(cv2.blur(lab, (3, 3))))  # [3, h, w]

    def correlate(self, lights: NDArray[np.uint8], seen: NDArray[np.int32], count: int) -> Map:
        """Compute the normalised cross-correlation with other lightnesses [n, h, w]: mean over the ``count`` best,
        -1..1, [h, w].

        It is 0 where there is no texture.

        Args:
            seen: [n, h, 2], the first and one past the last pixel of each row that shows anything; -1 elsewhere.
        """
        result = np.empty(self.lightness.shape, np.float32)
        self._call(lights, seen, None, 0.0, 0, None, None, len(lights), count, result)
        return result

    def compare(
        self, labs: NDArray[np.uint8], seen: NDArray[np.int32], count: int, most: float, last: int, count_last: int
    ) -> tuple[Map, Map, Map]:
        """Compare with other pictures, CIELAB [n, h, w, 3].

        Args:
            labs: CIELAB of the others, uint8 [n, h, w, 3].
            seen: as for :meth:`correlate`.
            count: how many of the others, the best for each pixel, count.
            most: CIELAB distance; other colours are not alike, whatever their pattern is.
            last: how many of the others, at the end of ``labs``, are compared without regard to colour as well.
            count_last: how many of these, the best for each pixel, count.

        Returns:
            [h, w] each: correlations, where the colours are alike; distances of the colours, negative, -255 where
            nothing is seen; correlations with the ``last`` pictures whatever the colours are: ``count_last`` count.
        """
        fits, colors, alone = (np.empty(self.lightness.shape, np.float32) for _ in range(3))
        self._call(labs, seen, self.smooth, most, count, fits, colors, last, count_last, alone)
        return fits, colors, alone

    def _call(
        self,
        others: NDArray[np.uint8],
        seen: NDArray[np.int32],
        smooth: NDArray[Any] | None,
        most: float,
        *rest: Any,
    ) -> None:
        """Call the kernel; ``rest`` are its last arguments, from the number of the best on."""
        failed = call(
            "mgf_compare_patches", len(others), *self.lightness.shape, 1 if others.ndim == 3 else others.shape[3],
            others, seen, self.lightness, self.average, self.variance, smooth, float(self.texture), float(most), *rest,
        )  # fmt: skip
        if failed:
            raise MemoryError("Not enough memory to compare patches of the photos; work at a lower resolution.")


def _mean(image: Map) -> Map:
    """Average over the patch around each pixel."""
    return np.asarray(cv2.blur(image, (PATCH, PATCH)), np.float32)
