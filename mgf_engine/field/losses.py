# SPDX-License-Identifier: GPL-3.0-or-later
"""The training losses, eq. 16-20: which terms act with which weight. :mod:`mgf_engine.raster.loss` computes them.

Pixels are pooled over the mask only: a mean over the whole frame would count the outside as perfect. The
boundary weight of eq. 12 acts once, as a weighted mean, which is what eq. 13, 15 and 17 say together when both
sides are weighted: ``|w C - w I| = w |C - I|``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from mgf_engine.config import Config
from mgf_engine.field.targets import Target
from mgf_engine.raster.api import Rendering
from mgf_engine.raster.loss import LossWeights, image_loss


@dataclass
class LossTerms:
    """The total (eq. 20) and its parts, each already weighted; scalars."""

    total: Tensor
    color: Tensor
    geometry: Tensor
    background: Tensor
    error: Tensor  # float32 [h, w] absolute colour error inside the box, no gradient


def total_loss(
    rendering: Rendering,
    target: Target,
    config: Config,
    backdrop: Tensor,
    geometry: float,
    error_map: Tensor | None = None,
    backend: str | None = None,
) -> LossTerms:
    """Eq. 20, plus the term that keeps certain background empty.

    Args:
        rendering: maps of the whole frame.
        backdrop: [3] colour behind the field for this iteration.
        geometry: factor on the distortion and normal terms; 0 where they do not act.
        error_map: float32 [H, W]; its box receives the error, which is a view of it then.
        backend: see :func:`mgf_engine.raster.loss.image_loss`.
    """
    y0, y1, x0, x1 = target.box
    error = rendering.color.new_empty(y1 - y0, x1 - x0) if error_map is None else target.crop(error_map)
    weights = loss_weights(target, config, geometry)
    terms = image_loss(rendering, target.photo_side, weights, backdrop, target.camera, error, backend)
    color, geometric, background = (torch.as_tensor(v) for v in (terms.color, terms.geometry, terms.background))
    return LossTerms(terms.total, color, geometric, background, error)


def loss_weights(target: Target, config: Config, geometry: float) -> LossWeights:
    """Factors of the terms; a colour term that is switched off hands its weight to the plain eq. 16."""
    multilevel = config.multilevel_lambda if config.multilevel_loss else 0.0
    boundary = config.boundary_lambda if config.boundary_loss else 0.0
    return LossWeights(
        plain=config.multilevel_lambda + config.boundary_lambda - multilevel - boundary,
        multilevel=multilevel,
        labels=target.label_weight.double().numpy() if multilevel > 0 else np.zeros(target.count + 1),
        boundary=boundary,
        edge=target.w_edge,
        l1=config.l1_weight,
        ssim=config.ssim_weight,
        background=config.background_lambda,
        distortion=config.distortion_lambda * geometry,
        normals=config.normal_lambda * geometry,
    )
