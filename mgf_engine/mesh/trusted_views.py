# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos whose masks decide what is solid and what is free, and what depth matching needs of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.model.scene import View


@dataclass(frozen=True)
class Photos:
    """What matching needs of the photos.

    Attributes:
        grey: number of a view -> uint8 [H, W], brightness.
        neighbours: per view the numbers of those to match it with.
    """

    grey: Callable[[int], NDArray[np.uint8]]
    neighbours: Sequence[Sequence[int]]


@dataclass(frozen=True)
class TrustedViews:
    """The photos whose masks are good enough to tell solid from free.

    Attributes:
        indices: their numbers in the scene.
        verdicts: per view uint8 [H, W], as :func:`mgf_engine.mesh.hull.judging_mask` makes them.
        labels: label map of each view.
        photos: their brightness, and which are compared; None where depths are not to be matched.
    """

    indices: list[int]
    views: list[View]
    verdicts: list[NDArray[np.uint8]]
    labels: list[NDArray[np.uint8]]
    photos: Photos | None
