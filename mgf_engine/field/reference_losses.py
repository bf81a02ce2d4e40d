# SPDX-License-Identifier: GPL-3.0-or-later
"""Reference of the training losses (eq. 16-20) in plain torch: same arguments, any float type, autograd; for tests."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from mgf_engine.field.losses import LossOptions, LossTerms
from mgf_engine.field.targets import Pixels, Target
from mgf_engine.raster.api import Rendering
from mgf_engine.raster.ms_ssim import FLOOR, MS_SSIM_WEIGHTS, WINDOW
from mgf_engine.raster.reference_losses import normal_consistency, ssim_maps


def total_loss(
    rendering: Rendering, target: Target, options: LossOptions, backdrop: Tensor, geometry: float
) -> LossTerms:
    """Compute as :func:`mgf_engine.field.losses.total_loss` does, in the type of ``rendering.color``.

    Args:
        rendering: maps of the whole frame.
        target: photo, mask and labels.
        options: weights of the terms.
        backdrop: [3], colour behind the field.
        geometry: factor on the geometric terms, 0 before they begin.
    """
    pixels = target.pixels(rendering.color.dtype)
    alpha = target.crop(rendering.alpha)
    color = target.crop(rendering.color) + (1.0 - alpha) * backdrop[:, None, None]
    # Outside the mask the photo stands in for the render, so that no window reaches over the edge.
    color = torch.where(pixels.inside > 0, color, pixels.photo)
    l1 = (color - pixels.photo).abs().mean(0)
    color_loss = _color_loss(color, l1, pixels, target.label_weight, target.elements, options)
    geometry_loss = alpha.new_zeros(())
    if geometry:
        geometry_loss = geometry * _geometry_loss(rendering, target, pixels, alpha, options)
    band = pixels.background_band
    background = options.background_lambda * (alpha * band).sum() / band.sum().clamp_min(1.0)
    error = l1.detach() + alpha.detach() * band
    total = color_loss + geometry_loss + background
    return LossTerms(total, color_loss.detach(), geometry_loss.detach(), background.detach(), error)


def _color_loss(
    color: Tensor, l1: Tensor, pixels: Pixels, label_weight: Tensor, elements: int, options: LossOptions
) -> Tensor:
    """Compute lambda_1 Loss_mlpm + lambda_2 Loss_boundary; a term switched off hands its weight to the plain eq. 16."""
    multilevel = options.multilevel_lambda if options.multilevel_loss else 0.0
    boundary = options.boundary_lambda if options.boundary_loss else 0.0
    plain = options.multilevel_lambda + options.boundary_lambda - multilevel - boundary
    per_pixel = plain * pixels.inside / pixels.inside.sum() + boundary * pixels.edge_weight / pixels.edge_weight.sum()
    ssim, contrast = ssim_maps(color, pixels.photo)
    l1_weight = per_pixel
    loss = options.ssim_weight * (per_pixel * (1.0 - ssim)).sum()
    if multilevel > 0:
        for share, mask in _masks(pixels.labels, label_weight, elements):
            l1_weight = l1_weight + multilevel * share * mask / mask.sum()
            similarity = ms_ssim(color, pixels, mask, ssim, contrast)
            loss = loss + multilevel * options.ssim_weight * share * (1.0 - similarity)
    return loss + options.l1_weight * (l1_weight * l1).sum()


def _masks(labels: Tensor, label_weight: Tensor, elements: int) -> Iterator[tuple[float, Tensor]]:
    """Weight and pixels (bool [h, w]) of the k masks of eq. 19: the whole building, and each of its elements."""
    yield float(label_weight[0]), (labels > 0) & (labels <= elements)
    for label in range(2, elements + 1):
        yield float(label_weight[label]), labels == label


def ms_ssim(color: Tensor, pixels: Pixels, mask: Tensor, ssim: Tensor, contrast: Tensor) -> Tensor:
    """Return multi-scale SSIM pooled over one mask; see :func:`mgf_engine.raster.ms_ssim.ms_ssim`.

    Args:
        color: [3, h, w], rendered.
        pixels: the photo's, and its weights.
        mask: bool [h, w].
        ssim, contrast: the maps at full resolution.
    """
    photo, side = pixels.photo, math.sqrt(int(mask.sum()))
    scales = sum(side >= WINDOW * 2.0**s for s in range(len(MS_SSIM_WEIGHTS)))
    scales = min(scales, int(math.log2(min(mask.shape))) + 1)
    exponents = color.new_tensor(MS_SSIM_WEIGHTS[:scales])
    log_similarity = color.new_zeros(())
    for scale in range(scales):
        if scale > 0:
            color, photo = F.avg_pool2d(color[None], 2)[0], F.avg_pool2d(photo[None], 2)[0]
            mask = mask[: mask.shape[0] // 2 * 2 : 2, : mask.shape[1] // 2 * 2 : 2]
            ssim, contrast = ssim_maps(color, photo)
        map = ssim if scale == scales - 1 else contrast
        value = map[mask].mean() if mask.any() else map.new_ones(())
        log_similarity = log_similarity + exponents[scale] / exponents.sum() * torch.log(value.clamp_min(FLOOR))
    return torch.exp(log_similarity)


@dataclass(frozen=True)
class _Intrinsics:
    fx: float
    fy: float
    cx: float
    cy: float


def _geometry_loss(rendering: Rendering, target: Target, pixels: Pixels, alpha: Tensor, options: LossOptions) -> Tensor:
    """Compute lambda_3 Loss_depth + lambda_4 Loss_normal (both from 2DGS), means over the mask."""
    assert rendering.distortion is not None and rendering.normal is not None
    distortion = (target.crop(rendering.distortion) * pixels.inside).sum() / pixels.inside.sum()
    loss = options.distortion_lambda * distortion
    if options.normal_lambda > 0:
        depth = target.crop(rendering.depth) / alpha.clamp_min(1e-4)
        weight = pixels.inside * (alpha.detach() > 0.5)
        camera, (y0, _, x0, _) = target.camera, target.box
        cut = _Intrinsics(camera.fx, camera.fy, camera.cx - x0, camera.cy - y0)
        loss = loss + options.normal_lambda * normal_consistency(
            depth, target.crop(rendering.normal), weight, cut, alpha
        )
    return loss
