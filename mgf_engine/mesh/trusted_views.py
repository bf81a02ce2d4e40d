# SPDX-License-Identifier: GPL-3.0-or-later
"""Data classes: photos whose masks are reliable, and what depth matching needs of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.model.scene import View


@dataclass(frozen=True)
class Photos:
    """Photos for patch matching.

    Attributes:
        grey: number of a view -> its photo in grey levels, uint8 [H, W].
        neighbours: for each view, the numbers of the views it is matched with.
    """

    grey: Callable[[int], NDArray[np.uint8]]
    neighbours: Sequence[Sequence[int]]


@dataclass(frozen=True)
class TrustedViews:
    """Photos whose masks are reliable enough to decide what is solid and what is free.

    Attributes:
        indices: their numbers in the scene.
        views: their cameras, normalised frame.
        silhouettes: for each view uint8 [H, W] from :func:`mgf_engine.mesh.hull.silhouette_mask`.
        labels: label map of each view, uint8 [H, W].
        photos: photos and neighbours for patch matching; None with ``match_photos`` off.
    """

    indices: list[int]
    views: list[View]
    silhouettes: list[NDArray[np.uint8]]
    labels: list[NDArray[np.uint8]]
    photos: Photos | None
