# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

from dataclasses import dataclass

import pytest
import torch

from mgf_engine.raster import library, reference_losses
from mgf_engine.raster.geometry import normal_consistency


@dataclass
class Pinhole:
    fx: float = 60.0
    fy: float = 63.0
    cx: float = 24.0
    cy: float = 17.5


def maps(height: int, width: int, seed: int = 0, holes: float = 0.03) -> list[torch.Tensor]:
    """A wavy depth map with holes, random normals, alphas and weights."""
    generator = torch.Generator().manual_seed(seed)

    def rand(*shape):
        return torch.rand(*shape, generator=generator)

    depth = 2 + 0.3 * torch.sin(torch.arange(width) * 0.3)[None] + 0.2 * rand(height, width)
    depth[rand(height, width) < holes] = 0
    weight = rand(height, width) * (rand(height, width) >= holes)
    return [depth, rand(3, height, width) - 0.5, rand(height, width), weight]


@pytest.mark.parametrize("size", [(3, 3), (4, 40), (17, 33), (48, 35), (65, 66)])
def test_value_and_gradients_match_the_twin(size):
    depth, normal, alpha, weight = maps(*size, holes=0.0 if size == (3, 3) else 0.03)
    ours = [m.clone().requires_grad_() for m in (depth, normal, alpha)]
    loss = normal_consistency(ours[0], ours[1], weight, Pinhole(), ours[2])
    (3 * loss).backward()
    twin = [m.double().requires_grad_() for m in (depth, normal, alpha)]
    expected = reference_losses.normal_consistency(twin[0], twin[1], weight.double(), Pinhole(), twin[2])
    (3 * expected).backward()
    assert abs(loss.item() - expected.item()) < 1e-6
    for a, b in zip(ours, twin, strict=True):
        # differences of neighbouring depths cancel: 2^-24 * depth / difference, about 1e-5 here
        assert (a.grad - b.grad).abs().max() <= 1e-4 * b.grad.abs().max()


def test_gradient_by_finite_differences():
    depth, normal, alpha, weight = (m.double() for m in maps(6, 7, holes=0.0))
    depth.requires_grad_()
    torch.autograd.gradcheck(
        lambda d: reference_losses.normal_consistency(d, normal, weight, Pinhole(), alpha), (depth,), eps=1e-6
    )


def test_plane_with_its_own_normal_costs_nothing():
    camera, height, width = Pinhole(), 30, 40
    direction = torch.nn.functional.normalize(torch.tensor([0.3, -0.2, -1.0]), dim=0)
    u = (torch.arange(width) + 0.5 - camera.cx) / camera.fx
    v = (torch.arange(height) + 0.5 - camera.cy) / camera.fy
    depth = -2.0 / (direction[0] * u[None] + direction[1] * v[:, None] + direction[2])
    ones = torch.ones(height, width)
    normal = direction[:, None, None].expand(3, height, width)
    assert normal_consistency(depth, normal, ones, camera) < 1e-5
    assert normal_consistency(depth, -normal, ones, camera) > 1.99
    assert normal_consistency(depth, 0.4 * normal, ones, camera, 0.4 * ones) < 1e-5


def test_pixels_without_neighbours_do_not_count():
    depth, normal, alpha, weight = maps(20, 20, holes=0.0)
    weight[:, 10:] = 0
    changed = depth.clone()
    changed[:, 11:] = 50.0
    a = normal_consistency(depth, normal, weight, Pinhole(), alpha)
    assert a == normal_consistency(changed, normal, weight, Pinhole(), alpha)
    depth.requires_grad_()
    normal_consistency(depth, normal, weight, Pinhole(), alpha).backward()
    assert depth.grad[:, 10:].abs().max() == 0


@pytest.mark.parametrize("size", [(1, 1), (2, 9), (9, 2), (5, 5)])
def test_nothing_valid_gives_zero_and_no_nan(size):
    depth, normal, alpha, weight = maps(*size)
    depth = torch.zeros_like(depth).requires_grad_()
    loss = normal_consistency(depth, normal, weight, Pinhole(), alpha)
    loss.backward()
    assert loss == 0 and depth.grad.abs().max() == 0


def test_same_sum_for_any_number_of_threads():
    data = maps(70, 50)
    library.set_threads(1)
    alone = normal_consistency(data[0], data[1], data[3], Pinhole(), data[2])
    library.set_threads(3)
    together = normal_consistency(data[0], data[1], data[3], Pinhole(), data[2])
    library.set_threads(0)
    assert alone == together


def test_wrong_sizes_are_refused():
    depth, normal, alpha, weight = maps(8, 8)
    with pytest.raises(ValueError, match="one size"):
        normal_consistency(depth, normal, weight, Pinhole(), alpha[1:])
