# SPDX-License-Identifier: GPL-3.0-or-later
"""Outputs of the rasterizer: images, and statistics of the contribution of each Gaussian."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor


@dataclass
class Rendering:
    """What a camera sees; float32, [.., H, W]. Pixels of tiles outside the mask are zero.

    Attributes:
        color: [3, H, W], premultiplied, without background.
        alpha: [H, W].
        depth: [H, W], sum of weight * depth along the optical axis (divide by alpha for the mean).
        median: [H, W], depth at which the transmittance passes 1/2, 0 where it never does; None with basic outputs.
        normal: [3, H, W], sum of weight * normal in the camera frame; None with basic outputs.
        distortion: [H, W], sum over pairs i < j of w_i w_j (m_i - m_j)^2 of mapped depths; None with basic outputs.
        visible: bool [N], true for Gaussians that touch a wanted tile.
    """

    color: Tensor
    alpha: Tensor
    depth: Tensor
    median: Tensor | None
    normal: Tensor | None
    distortion: Tensor | None
    visible: Tensor

    def cpu(self) -> Rendering:
        """Return the same in the CPU's memory; waits for the GPU."""
        there = {f.name: getattr(self, f.name) for f in fields(self)}
        return replace(self, **{name: value.cpu() for name, value in there.items() if value is not None})


@dataclass
class RenderStats:
    """How much each of N Gaussians contributed; added to by every backward pass of a rendering that was given it.

    Attributes:
        weight: float32 [N], sum of its blending weights over pixels.
        error: float32 [N], sum of weight * ``error_map``.
        gradient: float32 [N], sum over views of the length of dL/dc, c its projected centre in normalised device
            coordinates (half the frame is 1); moving c moves its response across the picture, in the shape that it has
            there.
        absolute_gradient: float32 [N], the same with the length taken in each pixel before the sum: not cancelling.
        max_radius: float32 [N], largest half extent of its footprint in pixels, over views.
        count: int32 [N], number of views in which its weight was above zero.
    """

    weight: Tensor
    error: Tensor
    gradient: Tensor
    absolute_gradient: Tensor
    max_radius: Tensor
    count: Tensor

    @classmethod
    def zeros(cls, n: int, device: torch.device | str = "cpu") -> RenderStats:
        weight, error, gradient, absolute, radius = torch.zeros(5, n, device=device).unbind(0)
        return cls(weight, error, gradient, absolute, radius, torch.zeros(n, dtype=torch.int32, device=device))

    def to(self, device: torch.device) -> RenderStats:
        """Return the statistics on a device."""
        return RenderStats(*(values.to(device) for values in self.all))

    @property
    def all(self) -> tuple[Tensor, ...]:
        return self.weight, self.error, self.gradient, self.absolute_gradient, self.max_radius, self.count
