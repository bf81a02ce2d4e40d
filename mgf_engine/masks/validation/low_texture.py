# SPDX-License-Identifier: GPL-3.0-or-later
"""Plain surfaces: parts of the building where photos show neither texture nor sparse points to tell depth."""

from __future__ import annotations

import cv2
import numpy as np

from mgf_engine.masks.points import pixel_at
from mgf_engine.model.masks import MaskSet, building
from mgf_engine.model.scene import Scene

#: Share of the building that may be plain. Painted flat in one colour, a house has 0.4 and keeps half of its F1.
PLAIN = 0.25
_CALM = 2.0  # grey values of 255: standard deviation in a window that says "no texture"
_WINDOW = 7  # pixels
_POINT = 0.01  # of the longest side: how far around a sparse point its surface counts as seen
_PHOTOS = 16  # looked at, spread over all


def low_texture_share(scene: Scene, masks: MaskSet) -> float:
    """Median over photos of the share of the building that is plain, 0..1; 0 where no mask is large enough."""
    used = np.flatnonzero(masks.used)
    shares = []
    for index in used[:: max(1, -(-len(used) // _PHOTOS))].tolist():
        grey = scene.photo(index)[..., 1].astype(np.float32)
        mean = cv2.blur(grey, (_WINDOW, _WINDOW))
        spread = np.sqrt(np.maximum(cv2.blur(grey * grey, (_WINDOW, _WINDOW)) - mean * mean, 0.0))
        inner = cv2.erode(building(masks.labels[index]).astype(np.uint8), np.ones((_WINDOW, _WINDOW), np.uint8)) > 0
        if inner.sum() >= _WINDOW**2:
            shares.append(float(((spread < _CALM) & ~_seen(scene, index, grey.shape))[inner].mean()))
    return float(np.median(shares)) if shares else 0.0


def _seen(scene: Scene, index: int, shape: tuple[int, ...]) -> np.ndarray:
    """Pixels near an observation, bool [H, W]."""
    near = np.zeros(shape, np.uint8)
    near[pixel_at(shape, scene.track_uv[scene.observations(index)])] = 1
    side = 2 * round(_POINT * max(shape)) + 1
    return np.asarray(cv2.dilate(near, np.ones((side, side), np.uint8)) > 0)


def low_texture_warning(share: float) -> str:
    """Compose the warning for a share of textureless surface."""
    return (
        f"{share:.0%} of the building has neither texture nor sparse points; the mesh is interpolated there. "
        "Closer photos, a higher --resolution or slanting light would help."
    )
