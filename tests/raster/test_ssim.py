# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

import pytest
import torch

from mgf_engine.raster import library, reference_losses
from mgf_engine.raster.ssim import ssim_maps, ssim_target

# float32 moments of values in 0..1 carry errors of about 1e-7; C2 = 9e-4 divides them.
MAP_TOLERANCE = 5e-6
GRAD_TOLERANCE = 2e-5  # relative to the largest gradient


def images(height: int, width: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    x = torch.rand(3, height, width, generator=generator)
    return x, (x + 0.3 * torch.rand(3, height, width, generator=generator)).clamp(0, 1)


def both_gradients(x, y, box=None):
    """Forward and backward of the kernel and of its twin for the same random dL/dmaps."""
    height, width = x.shape[1:]
    y0, y1, x0, x1 = box or (0, height, 0, width)
    inside = torch.zeros(height, width)
    inside[y0:y1, x0:x1] = 1
    generator = torch.Generator().manual_seed(7)
    g_ssim, g_cs = torch.randn(2, height, width, generator=generator)
    x32 = x.clone().requires_grad_()
    ssim, cs = ssim_maps(x32, y, box)
    (ssim * g_ssim + cs * g_cs).sum().backward()
    x64 = x.double().requires_grad_()
    ssim64, cs64 = reference_losses.ssim_maps(x64, y.double())
    ((ssim64 * g_ssim + cs64 * g_cs) * inside).sum().backward()
    return (ssim, cs, x32.grad), (ssim64 * inside, cs64 * inside, x64.grad)


@pytest.mark.parametrize("size", [(1, 1), (5, 7), (11, 11), (33, 16), (64, 100), (131, 95)])
def test_maps_and_gradient_match_the_twin(size):
    ours, twin = both_gradients(*images(*size))
    assert (ours[0] - twin[0]).abs().max() < MAP_TOLERANCE
    assert (ours[1] - twin[1]).abs().max() < MAP_TOLERANCE
    assert (ours[2] - twin[2]).abs().max() < GRAD_TOLERANCE * twin[2].abs().max()


@pytest.mark.parametrize("box", [(10, 50, 5, 77), (0, 64, 30, 31), (60, 64, 95, 100), (3, 44, 0, 100)])
def test_box_limits_maps_but_not_windows(box):
    ours, twin = both_gradients(*images(64, 100), box=box)
    for a, b in zip(ours[:2], twin[:2], strict=True):
        assert (a - b).abs().max() < MAP_TOLERANCE
    assert (ours[2] - twin[2]).abs().max() < GRAD_TOLERANCE * twin[2].abs().max()


def test_empty_box_gives_zeros():
    x, y = images(20, 20)
    x.requires_grad_()
    ssim, cs = ssim_maps(x, y, (5, 5, 0, 20))
    (ssim + cs).sum().backward()
    assert ssim.abs().max() == 0 and cs.abs().max() == 0 and x.grad.abs().max() == 0


def test_equal_images_are_perfect_and_stationary():
    x, _ = images(40, 40)
    render = x.clone().requires_grad_()
    ssim, cs = ssim_maps(render, x)
    assert torch.allclose(ssim, torch.ones(40, 40), atol=1e-5) and torch.allclose(cs, torch.ones(40, 40), atol=1e-5)
    ssim.sum().backward()
    assert render.grad.abs().max() < 1e-4


def test_flat_black_and_white_stay_finite():
    for value in (0.0, 1.0):
        x = torch.full((3, 30, 30), value, requires_grad=True)
        ssim, _ = ssim_maps(x, torch.full((3, 30, 30), 1 - value))
        ssim.sum().backward()
        assert torch.isfinite(ssim).all() and torch.isfinite(x.grad).all()


def test_padded_rows_target_and_threads_change_nothing():
    x, y = images(50, 70)
    padded = torch.zeros(3, 50, 80)
    padded[:, :, :70] = x
    plain = ssim_maps(x, y)[0]
    assert torch.equal(plain, ssim_maps(padded[:, :, :70], y)[0])
    library.set_threads(3)
    assert torch.equal(plain, ssim_maps(x, y)[0])
    library.set_threads(0)
    target = ssim_target(y)
    assert torch.equal(plain, ssim_maps(x, target)[0])
    box = (7, 33, 11, 50)
    assert torch.allclose(plain[7:33, 11:50], ssim_maps(x, target, box)[0][7:33, 11:50], atol=1e-6)
    turned = ssim_maps(x.transpose(1, 2), y.transpose(1, 2))[0]  # rows are not contiguous
    assert torch.allclose(turned.T, plain, atol=1e-5)


def test_wrong_sizes_and_types_are_refused():
    x, y = images(20, 20)
    with pytest.raises(ValueError, match="one size"):
        ssim_maps(x, y[:, :19])
    with pytest.raises(ValueError, match="float32"):
        ssim_maps(x.double(), y.double())
