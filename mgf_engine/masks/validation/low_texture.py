# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure the share of the building with neither texture nor sparse points, where depth is unknown."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from mgf_engine.model.masks import MaskSet, building
from mgf_engine.model.pixels import pixel_at
from mgf_engine.model.scene import Scene
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class LowTextureOptions:
    """Options of the warning of surfaces without texture."""

    warn_above: float = parameter(0.25, "Share of the building without texture that a warning is given for", high=1)
    deviation: float = parameter(2.0, "Standard deviation in a window without texture", "grey levels")
    window: int = parameter(7, "Side of the window", "px", low=3)
    near_point: float = parameter(
        0.01, "Distance to a sparse point within which a surface counts as seen, as a share of the longest side", high=1
    )
    photos: int = parameter(16, "Number of photos that are measured", low=1)


def low_texture_share(scene: Scene, masks: MaskSet, options: LowTextureOptions = LowTextureOptions()) -> float:
    """Measure the plain share of the building, 0..1: median over the photos; 0 where no mask is large enough."""
    used = np.flatnonzero(masks.used)
    window = (options.window, options.window)
    shares = []
    for index in used[:: max(1, -(-len(used) // options.photos))].tolist():
        inner = cv2.erode(building(masks.labels[index]).astype(np.uint8), np.ones(window, np.uint8)) > 0
        if inner.sum() < options.window**2:
            continue
        grey = scene.photo(index)[..., 1].astype(np.float32)
        mean = cv2.blur(grey, window)
        spread = np.sqrt(np.maximum(cv2.blur(grey * grey, window) - mean * mean, 0.0))
        plain = (spread < options.deviation) & ~_near_observations(scene, index, grey.shape, options)
        shares.append(float(plain[inner].mean()))
    return float(np.median(shares)) if shares else 0.0


def _near_observations(scene: Scene, index: int, shape: tuple[int, ...], options: LowTextureOptions) -> np.ndarray:
    """Return pixels near an observation, bool [H, W]."""
    near = np.zeros(shape, np.uint8)
    near[pixel_at(shape, scene.track_uv[scene.observations(index)])] = 1
    side = 2 * round(options.near_point * max(shape)) + 1
    return np.asarray(cv2.dilate(near, np.ones((side, side), np.uint8)) > 0)


def low_texture_warning(share: float) -> str:
    """Compose the warning for a share of textureless surface."""
    return (
        f"{share:.0%} of the building has neither texture nor sparse points; the mesh is interpolated there. "
        "Closer photos, a higher --resolution or slanting light would help."
    )
