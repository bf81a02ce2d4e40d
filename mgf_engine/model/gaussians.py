# SPDX-License-Identifier: GPL-3.0-or-later
"""The parameters of a Gaussian field (eq. 4-5) and what they mean."""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from torch import Tensor


@dataclass
class Gaussians:
    """Raw (unconstrained) parameters of N Gaussians, float32, contiguous, in the normalised frame.

    Attributes:
        positions: [N, 3] centres p.
        log_scales: [N, 3]; scales s = exp(log_scales).
        rotations: [N, 4] quaternions (w, x, y, z), local -> normalised frame, not necessarily of unit length.
        opacity_logits: [N]; opacity alpha = sigmoid(opacity_logits).
        sh: [N, 16, 3] spherical harmonics of the colour (coefficient 0 is the constant one);
            colour = max(0, 0.5 + sum_b Y_b(direction) sh[b]).
        filter_3d: [N] standard deviation of the 3D low-pass filter (Mip-Splatting); not trained. The kernels see
            scales sqrt(s^2 + filter^2) and opacity alpha * prod(s) / prod(sqrt(s^2 + filter^2)).
    """

    positions: Tensor
    log_scales: Tensor
    rotations: Tensor
    opacity_logits: Tensor
    sh: Tensor
    filter_3d: Tensor

    def __len__(self) -> int:
        return self.positions.shape[0]

    def select(self, index: Tensor) -> Gaussians:
        """Select the Gaussians at ``index`` (bool mask or int64 indices), as copies."""
        return Gaussians(**{f.name: getattr(self, f.name)[index].contiguous() for f in fields(self)})

    def to(self, device: torch.device) -> Gaussians:
        """Return the Gaussians on a device; tensors that are there already are shared."""
        return Gaussians(**{f.name: getattr(self, f.name).to(device) for f in fields(self)})

    @property
    def scales(self) -> Tensor:
        """[N, 3] scales with the 3D filter fused in."""
        return torch.sqrt(torch.exp(2 * self.log_scales) + self.filter_3d[:, None] ** 2)

    @property
    def opacities(self) -> Tensor:
        """[N] opacities with the 3D filter fused in."""
        ratio = torch.exp(self.log_scales.sum(1)) / self.scales.prod(1).clamp_min(1e-30)
        return torch.sigmoid(self.opacity_logits) * ratio


def rotation_matrices(quaternions: Tensor) -> Tensor:
    """Convert quaternions [N, 4] (w, x, y, z) of any length to rotations [N, 3, 3], local to normalised frame."""
    w, x, y, z = torch.nn.functional.normalize(quaternions, dim=1).unbind(1)
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], 1),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], 1),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], 1),
    ]
    return torch.stack(rows, 1)
