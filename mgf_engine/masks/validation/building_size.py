# SPDX-License-Identifier: GPL-3.0-or-later
"""Advise a higher resolution where the building is small in the working photos and the user's own show more."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from mgf_engine.model.masks import MaskSet, building
from mgf_engine.model.scene import Scene
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class BuildingSizeOptions:
    """Options of the advice on small buildings."""

    small: int = parameter(250, "Length of the building below which a higher resolution is advised", "px")
    share: float = parameter(0.33, "Share of the photo's longest side below which the building is small", high=1)
    advised: int = parameter(400, "Length that the building has at the advised resolution", "px", low=1)
    least_gain: float = parameter(1.5, "Minimum factor on the resolution that is advised", low=1)


def small_building_warning(
    scene: Scene, masks: MaskSet, options: BuildingSizeOptions = BuildingSizeOptions()
) -> str | None:
    """Return the advice on a building that is small in the photo that shows most of it; None where it is not.

    Args:
        scene: working photos, which know the size of the user's photos.
        masks: the building in each photo.
        options: what is small, and what is advised.
    """
    lengths = [_length(masks, index) for index in range(len(scene.views))]
    best = int(np.argmax(lengths))
    view, length = scene.views[best], lengths[best]
    side = max(view.width, view.height)
    original = max(view.original_width, view.original_height)
    if length == 0 or length >= min(options.small, options.share * side):
        return None
    advised = min(original, int(np.ceil(side * options.advised / length / 100)) * 100)
    if advised < options.least_gain * side:
        return None
    return (
        f"The building is small, at most {length} pixels long in the working photos; --resolution {advised} would give "
        f"it more detail (the photos have {original})."
    )


def _length(masks: MaskSet, index: int) -> int:
    """Return the longest side of the box around the building in a photo, px; 0 where its mask is not used."""
    if not masks.used[index]:
        return 0
    _, _, width, height = cv2.boundingRect(building(masks.labels[index]).astype(np.uint8))
    return max(width, height)
