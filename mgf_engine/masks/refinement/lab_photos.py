# SPDX-License-Identifier: GPL-3.0-or-later
"""Cache of the photos in CIELAB, for steps that compare each photo with many others."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.model.photo_cache import PhotoCache
from mgf_engine.model.scene import Scene


class LabPhotos:
    """Converts photos of a scene to OpenCV's 8-bit CIELAB, and keeps those used last; any number of threads may ask.

    Args:
        scene: photos.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._converted = PhotoCache()

    def lab(self, index: int) -> NDArray[np.uint8]:
        """Return the photo of a view: lightness 0..255 for 0..100, a + 128, b + 128; uint8 [H, W, 3], read-only."""
        return self._converted.get(
            self.scene.folder / self.scene.views[index].file,
            lambda _: np.asarray(cv2.cvtColor(self.scene.photo(index), cv2.COLOR_RGB2LAB), np.uint8),
        )

    def lightness(self, index: int) -> NDArray[np.uint8]:
        """Return the lightness alone, uint8 [H, W]."""
        return np.asarray(cv2.extractChannel(self.lab(index), 0), np.uint8)
