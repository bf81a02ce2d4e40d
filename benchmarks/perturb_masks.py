# SPDX-License-Identifier: GPL-3.0-or-later
"""Worse masks, as given by a user: too small, too large, full of holes, or of another photo altogether."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.perturb_copy import SceneCopy
from mgf_engine.model.masks import BUILDING


def erode(copy: SceneCopy, pixels: float) -> None:
    """Masks smaller by ``pixels`` (of a photo 480 wide) all around."""
    kernel = _disc(copy.pixels(pixels))
    for name in copy.names:
        building = _building(copy, name)
        copy.write_mask(name, cv2.erode(building, kernel, borderValue=0))


def dilate(copy: SceneCopy, pixels: float) -> None:
    """Masks larger by ``pixels`` all around."""
    kernel = _disc(copy.pixels(pixels))
    for name in copy.names:
        copy.write_mask(name, cv2.dilate(_building(copy, name), kernel))


def punch_holes(copy: SceneCopy, share: float) -> None:
    """Round holes, other ones in every photo, until ``share`` of the mask is gone."""
    for name in copy.names:
        building = _building(copy, name)
        wanted = (1 - share) * building.sum()
        radius = max(2, round(copy.pixels(12)))
        v, u = np.nonzero(building)
        while len(v) and building.sum() > wanted:
            at = int(copy.rng.integers(len(v)))
            cv2.circle(building, (int(u[at]), int(v[at])), radius, 0, -1)
        copy.write_mask(name, building)


def replace(copy: SceneCopy, share: float) -> None:
    """This share of the photos has a wrong mask: the ground beside the building, as after a click on a neighbour.

    The wrong mask is the true one mirrored top to bottom and without the building itself.
    """
    names = copy.names
    for index in copy.rng.permutation(len(names))[: round(share * len(names))]:
        building = _building(copy, names[index])
        wrong = building[::-1].copy()
        wrong[building > 0] = 0
        if not wrong.any():
            wrong = 1 - building
        copy.write_mask(names[index], wrong)


def _building(copy: SceneCopy, name: str) -> NDArray[np.uint8]:
    return (copy.mask(name) == BUILDING).astype(np.uint8)


def _disc(radius: float) -> NDArray[np.uint8]:
    side = 2 * max(1, round(radius)) + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)), np.uint8)
