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

from mgf_engine.field.targets import Target
from mgf_engine.options.config import job_option
from mgf_engine.raster.api import Rendering
from mgf_engine.raster.loss import LossWeights, image_loss


@dataclass(frozen=True)
class LossOptions:
    """Terms of the loss and their weights, eq. 16-20: options of the job."""

    multilevel_loss: bool = job_option("multilevel_loss")
    boundary_loss: bool = job_option("boundary_loss")
    l1_weight: float = job_option("l1_weight")
    ssim_weight: float = job_option("ssim_weight")
    multilevel_lambda: float = job_option("multilevel_lambda")
    boundary_lambda: float = job_option("boundary_lambda")
    distortion_lambda: float = job_option("distortion_lambda")
    normal_lambda: float = job_option("normal_lambda")
    background_lambda: float = job_option("background_lambda")


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
    options: LossOptions,
    backdrop: Tensor,
    geometry: float,
    error_map: Tensor | None = None,
    backend: str | None = None,
) -> LossTerms:
    """Compute eq. 20 plus the term that keeps certain background empty.

    Args:
        rendering: maps of the whole frame.
        target: what it is compared with.
        options: terms and their weights.
        backdrop: [3] colour behind the field for this iteration.
        geometry: factor on the distortion and normal terms; 0 where they do not act.
        error_map: float32 [H, W]; its box receives the error, which is a view of it then.
        backend: see :func:`mgf_engine.raster.loss.image_loss`.
    """
    y0, y1, x0, x1 = target.box
    error = rendering.color.new_empty(y1 - y0, x1 - x0) if error_map is None else target.crop(error_map)
    weights = loss_weights(target, options, geometry)
    terms = image_loss(rendering, target.loss_photo, weights, backdrop, target.camera, error, backend)
    color, geometric, background = (torch.as_tensor(v) for v in (terms.color, terms.geometry, terms.background))
    return LossTerms(terms.total, color, geometric, background, error)


def loss_weights(target: Target, options: LossOptions, geometry: float) -> LossWeights:
    """Return the factors of the terms; a colour term that is switched off leaves its weight to the plain eq. 16."""
    multilevel = options.multilevel_lambda if options.multilevel_loss else 0.0
    boundary = options.boundary_lambda if options.boundary_loss else 0.0
    return LossWeights(
        plain=options.multilevel_lambda + options.boundary_lambda - multilevel - boundary,
        multilevel=multilevel,
        labels=target.label_weight.double().numpy() if multilevel > 0 else np.zeros(target.count + 1),
        boundary=boundary,
        edge=target.w_edge,
        l1=options.l1_weight,
        ssim=options.ssim_weight,
        background=options.background_lambda,
        distortion=options.distortion_lambda * geometry,
        normals=options.normal_lambda * geometry,
    )
