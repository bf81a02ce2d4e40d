# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of the training loss in plain torch, any float type, autograd gradients; for tests.

The reference of the loss kernels is put together from them (:mod:`mgf_engine.field.reference_losses`).
"""

from __future__ import annotations

import torch
from torch import Tensor

from mgf_engine.raster.camera import Intrinsics


def ssim_maps(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Compute eq. 28 at every pixel and its contrast-structure factor, means over the channels; x, y [3, H, W] ->
    [H, W] each.

    Window 11x11, sigma 1.5, zero padding, C1 = 0.01^2, C2 = 0.03^2.
    """
    offset = torch.arange(-5, 6, dtype=x.dtype)
    line = torch.exp(-(offset**2) / (2 * 1.5**2))
    line = line / line.sum()
    window = (line[:, None] * line[None]).expand(3, 1, 11, 11)

    def blur(image: Tensor) -> Tensor:
        return torch.nn.functional.conv2d(image[None], window, padding=5, groups=3)[0]

    mx, my = blur(x), blur(y)
    vx, vy, cov = blur(x * x) - mx * mx, blur(y * y) - my * my, blur(x * y) - mx * my
    light = (2 * mx * my + 0.01**2) / (mx * mx + my * my + 0.01**2)
    structure = (2 * cov + 0.03**2) / (vx + vy + 0.03**2)
    return (light * structure).mean(0), structure.mean(0)


def depth_normals(depth: Tensor, camera: Intrinsics) -> Tensor:
    """Compute unit normals [3, H - 2, W - 2] of the inner pixels of a depth map [H, W], in the camera's frame, facing
    it."""
    height, width = depth.shape
    u = (torch.arange(width, dtype=depth.dtype) + 0.5 - camera.cx) / camera.fx
    v = (torch.arange(height, dtype=depth.dtype) + 0.5 - camera.cy) / camera.fy
    points = torch.stack([depth * u[None], depth * v[:, None], depth])
    across = points[:, 1:-1, 2:] - points[:, 1:-1, :-2]
    down = points[:, 2:, 1:-1] - points[:, :-2, 1:-1]
    return torch.nn.functional.normalize(torch.linalg.cross(down, across, dim=0), dim=0, eps=1e-15)


def normal_consistency(
    depth: Tensor, normal: Tensor, weight: Tensor, camera: Intrinsics, alpha: Tensor | None = None
) -> Tensor:
    """Measure how rendered normals agree with those of the rendered depth (lambda 4 of eq. 20): mean of
    ``alpha - <N, n>``.

    Args:
        depth: [H, W], along the optical axis; <= 0 is no surface.
        normal: [3, H, W], rendered normals in the camera's frame, premultiplied, facing the camera.
        weight: [H, W], >= 0; a pixel counts when it and its four neighbours have a positive weight and depth.
        camera: intrinsics of the maps.
        alpha: [H, W], accumulated opacity; None takes 1, so that pixels not fully covered cost something too.
    """
    alpha = torch.ones_like(depth) if alpha is None else alpha
    good = (weight > 0) & (depth > 0)
    valid = good[1:-1, 1:-1] & good[1:-1, 2:] & good[1:-1, :-2] & good[2:, 1:-1] & good[:-2, 1:-1]
    inner = weight[1:-1, 1:-1] * valid
    dot = (normal[:, 1:-1, 1:-1] * depth_normals(depth, camera)).sum(0)
    if not valid.any():
        return (depth.sum() + normal.sum() + alpha.sum()) * 0
    return (inner * (alpha[1:-1, 1:-1] - dot)).sum() / inner.sum()
