# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendering forward and backward on every backend, against the reference and against finite differences."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from rendered import (
    OUTPUTS,
    TOLERANCES,
    assert_agrees,
    assert_gradients_agree,
    camera,
    device_of,
    draw,
    gaussians,
    leaves,
    random_weights,
    run,
)

from mgf_engine.raster import reference
from mgf_engine.raster.api import RenderStats, render


def test_one_round_gaussian_in_the_middle(backend: str) -> None:
    field = gaussians(1)
    field.positions[:], field.log_scales[:], field.opacity_logits[:] = 0.0, -1.0, 0.0
    view = camera(33, 33)
    seen = draw(field, view, sh_degree=0, backend=backend)
    x, y = int(view.cx), int(view.cy)
    assert seen.alpha[y, x] == pytest.approx(0.5, abs=0.01)
    assert seen.depth[y, x] / seen.alpha[y, x] == pytest.approx(5.0, abs=0.01)
    assert torch.allclose(
        seen.normal[:, y, x] / seen.alpha[y, x], torch.tensor([0.0, 0.0, -1.0]).to(seen.normal), atol=0.05
    )
    assert seen.median[y, x] == 0.0 or seen.median[y, x] == pytest.approx(5.0, abs=0.01)
    assert seen.visible.tolist() == [True]


@pytest.mark.parametrize("sh_degree", [0, 1, 2, 3])
@pytest.mark.parametrize("outputs", ["all", "basic"])
def test_agrees_with_the_reference(backend: str, sh_degree: int, outputs: str) -> None:
    assert_agrees(gaussians(150, seed=sh_degree), camera(seed=sh_degree), backend, sh_degree=sh_degree, outputs=outputs)


def test_many_layers_until_nothing_passes(backend: str) -> None:
    field = gaussians(400, seed=7, spread=0.5, log_scale=-1.2)
    found = assert_agrees(field, camera(33, 20), backend)
    assert found.rendering.alpha.max() > 1 - 2e-4


@pytest.mark.parametrize("names", [("color",), ("alpha",), ("depth",), ("median",), ("normal",), ("distortion",)])
def test_a_loss_on_one_output_alone(backend: str, names: tuple[str, ...]) -> None:
    """Outputs without a gradient are skipped in the kernels; the others must not notice."""
    field, view = gaussians(80, seed=3), camera()
    certain = ~reference.uncertain(field, view, 2, None, 1e-3)
    weights = random_weights(view, names, 0, certain)
    error_map = torch.zeros(view.height, view.width)
    expected = run(field, view, "reference", weights, error_map, sh_degree=2)
    found = run(field, view, backend, weights, error_map, sh_degree=2)
    assert_gradients_agree(found, expected, TOLERANCES["plain"].gradient)


def test_gradients_match_finite_differences() -> None:
    """The reference's own formulas: central differences in float64, away from every threshold."""
    field, view = gaussians(6, seed=11, log_scale=-1.0), camera(20, 18)
    certain = ~reference.uncertain(field, view, 3, None, 1e-2)
    weights = random_weights(view, OUTPUTS, 0, certain)
    own = leaves(field, torch.float64)

    def loss(*values: torch.Tensor) -> torch.Tensor:
        moved = type(own)(*values, own.filter_3d)
        seen = reference.render(moved, view, 3)
        return sum((getattr(seen, name) * weight).sum() for name, weight in weights.items())

    given = (own.positions, own.log_scales, own.rotations, own.opacity_logits, own.sh)
    assert torch.autograd.gradcheck(loss, given, eps=1e-6, atol=1e-4, rtol=1e-4)


def test_kernel_gradients_match_differences_of_the_reference(variant: str) -> None:
    """A step along the kernels' gradient changes the reference's loss by as much as the gradient says."""
    field, view = gaussians(40, seed=5), camera()
    certain = ~reference.uncertain(field, view, 3, None, 2e-2)
    weights = random_weights(view, OUTPUTS, 0, certain)
    found = run(field, view, "cpu", weights, torch.zeros(view.height, view.width), sh_degree=3)

    def loss(name: str, step: torch.Tensor) -> float:
        moved = leaves(field, torch.float64)
        with torch.no_grad():
            getattr(moved, name).add_(step)
            seen = reference.render(moved, view, 3)
            return float(sum((getattr(seen, key) * weight).sum() for key, weight in weights.items()))

    for name, gradient in found.gradients.items():
        direction = gradient.double() / gradient.double().norm()
        difference = (loss(name, 1e-6 * direction) - loss(name, -1e-6 * direction)) / 2e-6
        assert difference == pytest.approx(float(gradient.double().norm()), rel=1e-3), name


def test_statistics(backend: str) -> None:
    field, view = gaussians(120, seed=4), camera()
    found = assert_agrees(field, view, backend)
    expected = assert_agrees(field, view, "reference")
    assert torch.equal(found.stats.count, expected.stats.count) and found.stats.count.max() == 1
    assert torch.allclose(found.stats.weight, expected.stats.weight, rtol=1e-4, atol=0.02)
    shown = expected.stats.count > 0
    # The kernels' footprint has a small margin.
    difference = (found.stats.max_radius - expected.stats.max_radius)[shown]
    assert difference.min() > -1e-2 and (difference / expected.stats.max_radius[shown]).max() < 0.01
    assert float(found.stats.weight.sum()) == pytest.approx(float(found.rendering.alpha.detach().sum()), rel=1e-4)


def test_gradient_of_the_projected_centre_matches_differences(backend: str) -> None:
    """Moving the principal point moves the response of a lone Gaussian across the picture, in the shape it has."""
    field, view = gaussians(1, seed=2, log_scale=-1.0), camera()
    field.positions[:], field.opacity_logits[:] = torch.tensor([0.3, -0.2, 0.1]), 1.0
    certain = ~reference.uncertain(field, view, 2, None, 2e-2)
    weights = random_weights(view, OUTPUTS, 0, certain)
    stats = run(field, view, backend, weights, torch.zeros(view.height, view.width), sh_degree=2).stats

    def loss(name: str, step: float) -> float:
        seen = reference.render(field, replace(view, **{name: getattr(view, name) + step}), 2)
        return float(sum((getattr(seen, key) * weight).sum() for key, weight in weights.items()))

    slopes = [(loss(name, 1e-5) - loss(name, -1e-5)) / 2e-5 for name in ("cx", "cy")]
    expected = math.hypot(slopes[0] * view.width / 2, slopes[1] * view.height / 2)
    assert float(stats.gradient) == pytest.approx(expected, rel=1e-3)
    assert float(stats.absolute_gradient) > 1.5 * expected  # pixels of random weights pull apart


def test_statistics_add_up_over_views(backend: str) -> None:
    field, stats = leaves(gaussians(60)), RenderStats.zeros(60, device_of(backend))
    for seed in (1, 2):
        seen = draw(field, camera(seed=seed), sh_degree=0, backend=backend, stats=stats)
        seen.color.sum().backward()
    assert stats.count.max() == 2


def test_no_statistics_without_a_backward_pass(backend: str) -> None:
    stats = RenderStats.zeros(20, device_of(backend))
    with torch.no_grad():
        draw(gaussians(20), camera(), sh_degree=0, backend=backend, stats=stats)
    assert stats.count.sum() == 0


def test_two_renderings_before_their_backward_passes(backend: str) -> None:
    """Scratch memory is recycled, but never while a rendering still needs it."""
    field = gaussians(100, seed=9)
    one, two = camera(seed=1), camera(40, 30, seed=2)
    alone = leaves(field)
    draw(alone, one, sh_degree=1, backend=backend).color.sum().backward()
    draw(alone, two, sh_degree=1, backend=backend).depth.sum().backward()
    together = leaves(field)
    first = draw(together, one, sh_degree=1, backend=backend)
    second = draw(together, two, sh_degree=1, backend=backend)
    (first.color.sum() + second.depth.sum()).backward()
    for name in ("positions", "sh"):
        a, b = getattr(alone, name).grad, getattr(together, name).grad
        assert torch.allclose(a, b, rtol=1e-5, atol=1e-5 * float(a.abs().max()))


def test_changing_an_output_in_place_is_noticed() -> None:
    seen = render(leaves(gaussians(10)), camera(), sh_degree=0)
    with torch.no_grad():
        seen.alpha.mul_(2.0)
    with pytest.raises(RuntimeError, match="modified inplace"):
        seen.color.sum().backward()


def test_wrong_arguments_are_named() -> None:
    field, view = gaussians(3), camera()
    with pytest.raises(ValueError, match="tile_mask"):
        render(field, view, sh_degree=0, tile_mask=torch.ones(1, 1))
    with pytest.raises(ValueError, match="sh_degree"):
        render(field, view, sh_degree=4)
    with pytest.raises(ValueError, match="backend"):
        render(field, view, sh_degree=0, backend="vulkan")
    with pytest.raises(ValueError, match="stats"):
        render(field, view, sh_degree=0, stats=RenderStats.zeros(4))
    with pytest.raises(ValueError, match="error_map"):
        render(field, view, sh_degree=0, error_map=torch.zeros(2, 2))
    field.log_scales = field.log_scales[:2]
    with pytest.raises(ValueError, match="log_scales"):
        render(field, view, sh_degree=0)
