# SPDX-License-Identifier: GPL-3.0-or-later
"""Structural similarity of a render and its photo as maps, so that losses can pool them over any mask (eq. 16-18).

Window 11x11, sigma 1.5, zero padding, C1 = 0.01^2, C2 = 0.03^2 (eq. 28). The contrast-structure map is the
similarity without its luminance factor; multi-scale SSIM is made of both. The twin in float64 is
:func:`mgf_engine.raster.reference_losses.ssim_maps`.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from mgf_engine.raster.library import parallel

RADIUS = 5  # of the window, in pixels: how far the maps at a pixel look

Box = tuple[int, int, int, int]  # y0, y1, x0, x1; the ends are not included


@dataclass(frozen=True)
class SsimTarget:
    """A photo with its blurred moments; make it once with :func:`ssim_target` when the photo is compared often.

    Attributes:
        image: float32 [3, H, W].
        moments: float32 [2, 3, h, w], mean and variance inside ``box``.
        box: where the moments are known.
    """

    image: Tensor
    moments: Tensor
    box: Box


def ssim_target(image: Tensor, box: Box | None = None) -> SsimTarget:
    """The photo [3, H, W] (float32, 0..1) with its moments inside ``box`` (whole image when None)."""
    image = _rows(image)
    y0, y1, x0, x1 = box = _checked_box(box, image)
    moments = torch.empty(2, 3, y1 - y0, x1 - x0)
    if moments.numel():
        _run("ssim_target_work", *_strided(image), *image.shape[1:], *box, moments)
    return SsimTarget(image, moments, box)


def ssim_maps(x: Tensor, y: Tensor | SsimTarget, box: Box | None = None) -> tuple[Tensor, Tensor]:
    """Similarity and contrast-structure maps, means over the three channels; differentiable in ``x``.

    Args:
        x: render, float32 [3, H, W] on the CPU; rows may be padded.
        y: photo of the same size, or its :class:`SsimTarget`.
        box: only pixels inside are computed, the maps are zero elsewhere (whole image when None). Pixels up to
            :data:`RADIUS` outside the box still take part in the windows.

    Returns:
        ssim [H, W], cs [H, W], float32.

    Raises:
        ValueError: sizes or types do not fit.
    """
    image = y.image if isinstance(y, SsimTarget) else y
    if x.shape != image.shape or x.dim() != 3 or x.shape[0] != 3 or x.dtype != torch.float32:
        raise ValueError(f"x and y must be float32 [3, H, W] of one size, not {[*x.shape]} and {[*image.shape]}")
    box = _checked_box(box, x)
    target = y if isinstance(y, SsimTarget) and _contains(y.box, box) else ssim_target(image, box)
    return _SsimMaps.apply(x, target, box)  # type: ignore[no-any-return, no-untyped-call]


class _SsimMaps(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, target: SsimTarget, box: Box) -> tuple[Tensor, Tensor]:
        x = _rows(x.detach())
        y0, y1, x0, x1 = box
        ssim, cs = torch.zeros(2, *x.shape[1:]).unbind()
        saved = torch.empty(3, 3, y1 - y0, x1 - x0)
        if saved.numel():
            _run("ssim_forward_work", *_images(x, target, box), ssim, cs, saved)
        ctx.save_for_backward(x, saved)
        ctx.target, ctx.box = target, box
        return ssim, cs

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None, None]:
        x, saved = ctx.saved_tensors
        g_ssim, g_cs = (g.to(torch.float32).contiguous() for g in grads)
        grad = torch.zeros(x.shape)
        if saved.numel():
            _run("ssim_backward_work", *_images(x, ctx.target, ctx.box), saved, g_ssim, g_cs, grad)
        return grad, None, None


def _images(x: Tensor, target: SsimTarget, box: Box) -> tuple[Any, ...]:
    """The arguments forward and backward share: both images, the target's moments from the box on, sizes, box."""
    y, moments = target.image, target.moments
    ty, tx = box[0] - target.box[0], box[2] - target.box[2]
    return (
        *_strided(x), *_strided(y),
        *_strided(moments[..., ty:, tx:]),
        *x.shape[1:], *box,
    )  # fmt: skip


def _strided(image: Tensor) -> tuple[Any, ...]:
    """Pointer and all strides but the last, which is one."""
    return ctypes.c_void_p(image.data_ptr()), *image.stride()[:-1]


def _run(name: str, *arguments: Any) -> None:
    failed = torch.zeros(1, dtype=torch.int32)
    parallel(name, *arguments, failed)
    if failed.item():
        raise MemoryError("Not enough memory for the similarity maps; work at a lower resolution.")


def _rows(image: Tensor) -> Tensor:
    """The image as the kernels take it: float32 with neighbouring pixels of a row side by side."""
    image = image.detach().to(torch.float32)
    return image if image.stride(2) == 1 or image.shape[2] == 1 else image.contiguous()


def _checked_box(box: Box | None, image: Tensor) -> Box:
    height, width = image.shape[1:]
    if box is None:
        return 0, height, 0, width
    y0, y1, x0, x1 = (int(v) for v in box)
    y0, x0 = max(y0, 0), max(x0, 0)
    return y0, max(min(y1, height), y0), x0, max(min(x1, width), x0)


def _contains(outer: Box, inner: Box) -> bool:
    return outer[0] <= inner[0] and inner[1] <= outer[1] and outer[2] <= inner[2] and inner[3] <= outer[3]
