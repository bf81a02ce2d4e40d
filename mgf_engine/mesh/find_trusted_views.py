# SPDX-License-Identifier: GPL-3.0-or-later
"""Select the photos whose masks are reliable, and the neighbours of each for depth matching."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.masks.geometry.visual_hull import points_to_match
from mgf_engine.mesh.hull import silhouette_masks
from mgf_engine.mesh.options import ExtractionOptions
from mgf_engine.mesh.screening import voting_views
from mgf_engine.mesh.trusted_views import Photos, TrustedViews
from mgf_engine.model.masks import MaskSet
from mgf_engine.model.scene import Scene


def find_trusted_views(scene: Scene, masks: MaskSet, options: ExtractionOptions = ExtractionOptions()) -> TrustedViews:
    """Select the photos whose masks are reliable, and find the neighbours of each for depth matching.

    Args:
        scene: photos, cameras and sparse points.
        masks: label maps of the photos.
        options: of the masks and of the matching.

    Raises:
        BadInput: there is no such photo.
    """
    chosen = voting_views(scene, masks)
    if not chosen:
        raise BadInput("No photo has a usable mask, so no view can say what is solid; add clicks on the building.")
    return TrustedViews(
        chosen,
        [scene.views[i] for i in chosen],
        silhouette_masks(masks, chosen, options.dilation),
        [masks.labels[i] for i in chosen],
        _photos(scene, masks, chosen, options) if options.match_photos else None,
    )


def _photos(scene: Scene, masks: MaskSet, chosen: Sequence[int], options: ExtractionOptions) -> Photos:
    """Find the neighbours of the chosen photos; numbers are positions in ``chosen``."""
    position = {view: number for number, view in enumerate(chosen)}
    points = points_to_match(scene, masks, chosen, options.mask_hull)
    pairs = points.neighbours(options.neighbours, options.matching)

    def grey(number: int) -> NDArray[np.uint8]:
        return np.asarray(cv2.cvtColor(scene.photo(chosen[number]), cv2.COLOR_RGB2GRAY), np.uint8)

    return Photos(grey, [[position[k] for k in pairs[i]] for i in chosen])
