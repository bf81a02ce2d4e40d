# SPDX-License-Identifier: GPL-3.0-or-later
"""Planes of the image in which the loss kernels write the gradients of the rendered maps."""

from __future__ import annotations

from torch import Tensor

from mgf_engine.raster.loss_inputs import LossWeights

#: First plane of each map; the colour has planes 0..2, the normal the last three.
ALPHA, DISTORTION, DEPTH, NORMAL = 3, 4, 5, 6
_PLANES = 9


def count_planes(weights: LossWeights) -> int:
    """Return the number of planes that the terms with these weights write."""
    return _PLANES if weights.normals > 0 else DEPTH if weights.distortion > 0 else DISTORTION


def split_planes(gradient: Tensor, weights: LossWeights) -> list[Tensor]:
    """Return the gradients of colour [3, H, W], alpha and, where they have a weight, distortion, depth and normal.

    Args:
        gradient: all planes, float32 [P, H, W].
        weights: of the terms.
    """
    distortion = [gradient[DISTORTION]] if weights.distortion > 0 else []
    normals = [gradient[DEPTH], gradient[NORMAL:]] if weights.normals > 0 else []
    return [gradient[:ALPHA], gradient[ALPHA], *distortion, *normals]
