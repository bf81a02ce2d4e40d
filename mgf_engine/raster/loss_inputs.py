# SPDX-License-Identifier: GPL-3.0-or-later
"""Inputs of the image losses: the photo with its labels, and the weights of the terms."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor


@dataclass(frozen=True)
class LossPhoto:
    """The photo that a render is compared with, as the loss kernels read it, cut to a box of the frame.

    Made by :func:`mgf_engine.raster.loss_photo.prepare_photo`.

    Attributes:
        image: uint8 [3, h, w].
        labels: uint8 [h, w]; 0 where nothing is compared, else 1..ids - 1.
        elements: labels 1..elements together are the whole building, a mask of its own.
        edges: uint8 [h, w]; boundaries of labels.
        background_band: uint8 [h, w]; certain background near the building.
        origin: first row and column of the box in the frame.
        area: int64 [scales, ids], pixels of each label at the scales of MS-SSIM; in place of label 0, of the whole
            building.
        edge_area: number of labelled edge pixels.
        band_area: number of pixels of the background band.
        levels: int64 [scales, 9], struct Level of ``csrc/raster/loss.h``.
        flags: uint8 [tiles of all levels].
        strips: uint8, whether 16 rows hold a label.
        scratch: floats of scratch memory the kernels need.
    """

    image: Tensor
    labels: Tensor
    elements: int
    edges: Tensor
    background_band: Tensor
    origin: tuple[int, int]
    area: NDArray[np.int64]
    edge_area: int
    band_area: int
    levels: NDArray[np.int64]
    flags: NDArray[np.uint8]
    strips: NDArray[np.uint8]
    scratch: int

    @cached_property
    def copies(self) -> dict[Any, Any]:
        """Copies of this photo on GPUs (:func:`mgf_engine.raster.cuda.loss.photo_on`)."""
        return {}


@dataclass(frozen=True)
class LossWeights:
    """Factors of the terms, and how MS-SSIM is weighted per label.

    Attributes:
        plain: of the RGB loss, eq. 16.
        multilevel: of the multi-level perceptual mask loss, eq. 18-19; ``labels``: float [ids], share of each label; in
            place of label 0, of the whole building.
        boundary: of the boundary loss, eq. 17; ``edge``: weight of a boundary pixel, eq. 12.
        l1, ssim: of the two parts of each of them.
        background: of the mean alpha over the background band.
        distortion, normals: of the two geometry terms of eq. 20.
    """

    plain: float
    multilevel: float
    labels: NDArray[np.float64]
    boundary: float
    edge: float
    l1: float
    ssim: float
    background: float
    distortion: float
    normals: float
