# SPDX-License-Identifier: GPL-3.0-or-later
"""The fused Adam step against the plain one and against torch.optim."""

from __future__ import annotations

import pytest
import torch
from rendered import device_of

from mgf_engine.raster.adam import AdamStep, adam_step

SHAPES = [(0, 3), (1, 3), (7, 4), (100,), (300, 16, 3), (5000, 3)]


def tensors(*shape: int) -> list[torch.Tensor]:
    """Parameter, gradient and both moments."""
    g = torch.Generator().manual_seed(0)
    p, gradient, m, v = (torch.randn(*shape, generator=g) for _ in range(4))
    return [p, gradient, 0.1 * m, 0.01 * v.abs()]


def take(values: list[torch.Tensor], step: AdamStep, visible: torch.Tensor | None = None, **options) -> None:
    parameter, gradient, first, second = values
    adam_step(parameter, gradient, (first, second), step, visible, **options)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("case", ["all", "seen", "rates", "columns"])
def test_agrees_with_plain_torch(backend: str, shape: tuple[int, ...], case: str) -> None:
    ours, reference = [t.to(device_of(backend)) for t in tensors(*shape)], tensors(*shape)
    width = ours[0].shape[1:].numel()
    seen = torch.rand(shape[0], generator=torch.Generator().manual_seed(1)) < 0.6 if case != "all" else None
    rate = torch.linspace(0.01, 0.1, width) if case in ("rates", "columns") else 0.02
    active = max(1, width // 4) if case == "columns" else None
    for step in (1, 2, 50):
        shown = None if seen is None else seen.to(ours[0].device)
        take(ours, AdamStep(rate, step), shown, active=active, backend=backend)
        take(reference, AdamStep(rate, step), seen, active=active, backend="reference")
    for a, b, start in zip([t.cpu() for t in ours], reference, tensors(*shape), strict=True):
        assert torch.allclose(a, b, rtol=1e-5, atol=1e-5)  # steps of up to 10 where v is almost 0
        if seen is not None:
            assert torch.equal(a[~seen], start[~seen]), "a row that was not seen has changed"


def test_agrees_with_torch_optim(variant: str) -> None:
    p, gradient, _, _ = tensors(50, 3)
    own, m, v = p.clone(), torch.zeros(50, 3), torch.zeros(50, 3)
    parameter = torch.nn.Parameter(p.clone())
    optimiser = torch.optim.Adam([parameter], lr=0.05, eps=1e-15)
    for step in range(1, 11):
        parameter.grad = gradient * step
        optimiser.step()
        adam_step(own, gradient * step, (m, v), AdamStep(0.05, step))
    assert torch.allclose(own, parameter.detach(), atol=1e-5)


def test_wrong_rates_are_refused() -> None:
    with pytest.raises(ValueError, match="rates"):
        take(tensors(5, 3), AdamStep(torch.ones(2), 1))
    with pytest.raises(ValueError, match="float32"):
        take([t.double() for t in tensors(5, 3)], AdamStep(0.1, 1))
