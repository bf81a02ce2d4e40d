# SPDX-License-Identifier: GPL-3.0-or-later
"""Agreement of the rendered normals with the rendered depth: the normal consistency of eq. 20 (lambda 4).

The depth map is read as a surface of points; its normals come from central differences and face the camera. The
loss of a pixel is ``alpha - <N, n>`` with N the rendered normal (premultiplied by the weights of the blending) and
n the normal of the depth: zero where all Gaussians that make the pixel lie flat on the surface. The twin in
float64 is :func:`mgf_engine.raster.reference_losses.normal_consistency`.
"""

from __future__ import annotations

from typing import Any, Protocol

import torch
from torch import Tensor

from mgf_engine.raster.library import parallel

STRIP = 16  # rows of a strip, as in the kernel; one partial sum each, so the sum does not depend on the threads


class Intrinsics(Protocol):
    """What is needed of a camera: focal lengths and principal point in pixels (first pixel's centre 0.5, 0.5)."""

    @property
    def fx(self) -> float: ...
    @property
    def fy(self) -> float: ...
    @property
    def cx(self) -> float: ...
    @property
    def cy(self) -> float: ...


def normal_consistency(
    depth: Tensor, normal: Tensor, weight: Tensor, camera: Intrinsics, alpha: Tensor | None = None
) -> Tensor:
    """Weighted mean of ``alpha - <normal, normal of the depth>``, differentiable in depth, normal and alpha.

    Args:
        depth: [H, W], depth along the optical axis (expected depth divided by alpha, or median); <= 0 is no surface.
        normal: [3, H, W], rendered normals in the camera's frame, premultiplied, facing the camera.
        weight: [H, W], >= 0, weight of each pixel; not differentiated.
        camera: the intrinsics of the view.
        alpha: [H, W], accumulated opacity; None takes 1, so that pixels not fully covered cost something too.

    Returns:
        a scalar; 0 where no pixel counts. A pixel counts when it and its four neighbours have a positive weight
        and a positive depth.

    Raises:
        ValueError: sizes do not fit.
    """
    alpha = torch.ones_like(depth) if alpha is None else alpha
    height, width = depth.shape
    if normal.shape != (3, height, width) or alpha.shape != depth.shape or weight.shape != depth.shape:
        raise ValueError("depth, alpha and weight must be [H, W] and normal [3, H, W] of one size")
    return _NormalConsistency.apply(depth, normal, alpha, weight, camera)  # type: ignore[no-any-return, no-untyped-call]


class _NormalConsistency(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, depth: Tensor, normal: Tensor, alpha: Tensor, weight: Tensor, camera: Intrinsics) -> Tensor:
        maps = [m.detach().to(torch.float32).contiguous() for m in (depth, normal, alpha, weight)]
        height, width = depth.shape
        sums = torch.zeros(-(-height // STRIP), 2, dtype=torch.float64)
        grads = [torch.zeros(m.shape) for m in maps[:3]]
        if height >= 3 and width >= 3:
            intrinsics = (float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy))
            failed = torch.zeros(1, dtype=torch.int32)
            parallel("normal_consistency_work", *maps, height, width, *intrinsics, sums, *grads, failed)
            if failed.item():
                raise MemoryError("Not enough memory for the normal consistency; work at a lower resolution.")
        loss, total = sums.sum(0).tolist()
        ctx.scale = 1.0 / total if total > 0 else 0.0
        ctx.save_for_backward(*grads)
        return torch.tensor(loss * ctx.scale, dtype=torch.float32)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        scale = grads[0] * ctx.scale
        return (*(g * scale for g in ctx.saved_tensors), None, None)
