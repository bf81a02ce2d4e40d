# SPDX-License-Identifier: GPL-3.0-or-later
"""What the loss kernels are compared with: checked against what must be true, and a second implementation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import torch

from mgf_engine.evaluation.images import ssim_map
from mgf_engine.raster.reference_losses import normal_consistency, ssim_maps


@dataclass
class Pinhole:
    fx: float = 60.0
    fy: float = 63.0
    cx: float = 24.0
    cy: float = 17.5


def images(height: int, width: int) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    x = torch.rand(3, height, width, generator=generator, dtype=torch.float64)
    noise = torch.rand(3, height, width, generator=generator, dtype=torch.float64)
    return x, (x + 0.3 * noise).clamp(0, 1)


def test_similarity_is_that_of_the_report_away_from_the_frame() -> None:
    x, y = images(40, 50)
    other = ssim_map(*(image.permute(1, 2, 0).numpy() for image in (x, y)))
    assert np.abs(ssim_maps(x, y)[0].numpy() - other)[5:-5, 5:-5].max() < 1e-9


def test_equal_images_are_perfect_and_stationary() -> None:
    x, _ = images(40, 40)
    render = x.clone().requires_grad_()
    ssim, structure = ssim_maps(render, x)
    for found in (ssim, structure):
        assert torch.allclose(found, torch.ones(40, 40, dtype=torch.float64))
    ssim.sum().backward()
    assert render.grad is not None and render.grad.abs().max() < 1e-9


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_flat_black_and_white_stay_finite(value: float) -> None:
    x = torch.full((3, 30, 30), value, dtype=torch.float64, requires_grad=True)
    ssim_maps(x, torch.full_like(x, 1 - value))[0].sum().backward()
    assert x.grad is not None and torch.isfinite(x.grad).all()


def maps(height: int, width: int) -> list[torch.Tensor]:
    """A wavy depth map, random normals, alphas and weights."""
    generator = torch.Generator().manual_seed(0)

    def rand(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=generator, dtype=torch.float64)

    depth = 2 + 0.3 * torch.sin(torch.arange(width) * 0.3)[None] + 0.2 * rand(height, width)
    return [depth, rand(3, height, width) - 0.5, rand(height, width), rand(height, width)]


def test_a_plane_with_its_own_normal_costs_nothing() -> None:
    camera, height, width = Pinhole(), 30, 40
    direction = torch.nn.functional.normalize(torch.tensor([0.3, -0.2, -1.0], dtype=torch.float64), dim=0)
    u = (torch.arange(width) + 0.5 - camera.cx) / camera.fx
    v = (torch.arange(height) + 0.5 - camera.cy) / camera.fy
    depth = -2.0 / (direction[0] * u[None] + direction[1] * v[:, None] + direction[2])
    ones = torch.ones(height, width, dtype=torch.float64)
    normal = direction[:, None, None].expand(3, height, width)
    assert abs(normal_consistency(depth, normal, ones, camera)) < 1e-6
    assert abs(normal_consistency(depth, -normal, ones, camera) - 2) < 1e-6
    assert abs(normal_consistency(depth, 0.4 * normal, ones, camera, 0.4 * ones)) < 1e-6


def test_pixels_without_neighbours_do_not_count() -> None:
    depth, normal, alpha, weight = maps(20, 20)
    weight[:, 10:] = 0
    changed = depth.clone()
    changed[:, 11:] = 50.0
    depth.requires_grad_()
    loss = normal_consistency(depth, normal, weight, Pinhole(), alpha)
    assert loss == normal_consistency(changed, normal, weight, Pinhole(), alpha)
    loss.backward()
    assert depth.grad is not None and depth.grad[:, 10:].abs().max() == 0


@pytest.mark.parametrize("size", [(3, 3), (5, 5)])
def test_nothing_valid_gives_zero(size: tuple[int, int]) -> None:
    depth, normal, alpha, weight = maps(*size)
    depth = torch.zeros_like(depth).requires_grad_()
    loss = normal_consistency(depth, normal, weight, Pinhole(), alpha)
    loss.backward()
    assert loss == 0 and depth.grad is not None and depth.grad.abs().max() == 0
