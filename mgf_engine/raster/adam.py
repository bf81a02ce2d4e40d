# SPDX-License-Identifier: GPL-3.0-or-later
"""The Adam step (Kingma & Ba, 2015), fused, for the rows of a parameter that the last view saw."""

from __future__ import annotations

import torch
from torch import Tensor

from mgf_engine.native.library import parallel
from mgf_engine.raster.device import backend_for

_MOST_RATES = 48  # csrc/cuda/adam.cu


def adam_step(
    parameter: Tensor,
    gradient: Tensor,
    exp_avg: Tensor,
    exp_avg_sq: Tensor,
    lr: float | Tensor,
    step: int,
    visible: Tensor | None = None,
    *,
    betas: tuple[float, float] = (0.9, 0.999),
    eps: float = 1e-15,
    active: int | None = None,
    backend: str | None = None,
) -> None:
    """Take one step in place: ``p -= lr * m / (1 - b1^step) / (sqrt(v / (1 - b2^step)) + eps)``.

    Args:
        parameter: float32 [N, ...], contiguous; a row is everything behind the first axis, W numbers.
        gradient: as ``parameter``.
        exp_avg: first moment m, as ``parameter``.
        exp_avg_sq: second moment v, as ``parameter``.
        lr: learning rate, or one per number of a row, float32 [W] on the CPU.
        step: number of this step, from 1.
        visible: bool [N]; other rows and their moments stay as they are. None: all rows.
        betas: decay rates b1, b2 of the moments.
        eps: added to the root of the second moment.
        active: only the first so many numbers of each row are touched. None: all.
        backend: ``cpu``, ``cuda``, ``cuda-source-on-cpu`` or ``reference`` (plain torch). None: ``cuda`` for parameters
            on a card, else ``cpu``.

    Raises:
        ValueError: a tensor is not float32 or has another shape, or ``lr`` has too many rates or not one for each
            number.
    """
    backend = backend_for(parameter, backend)
    rows = len(parameter)
    width = parameter.shape[1:].numel()
    active = width if active is None else active
    bias1, bias2 = 1 / (1 - betas[0] ** step), 1 / (1 - betas[1] ** step)
    seen = None if visible is None else visible.to(torch.bool).contiguous()
    if backend == "reference":
        _reference(parameter, gradient, exp_avg, exp_avg_sq, lr, betas, eps, bias1, bias2, seen, active)
        return
    arrays = [t.detach() for t in (parameter, gradient.contiguous(), exp_avg, exp_avg_sq)]
    if any(t.dtype != torch.float32 or t.numel() != rows * width for t in arrays):
        raise ValueError("parameter, gradient and moments must be float32 of one shape")
    if isinstance(lr, Tensor) and lr.numel() != width:
        raise ValueError(f"lr has {lr.numel()} rates for rows of {width} numbers")
    uniform = not isinstance(lr, Tensor) or bool((lr == lr[0]).all())  # whole stretches of rows in one loop
    rate = float(lr[0]) if isinstance(lr, Tensor) else float(lr)
    rates = None if uniform or not isinstance(lr, Tensor) else lr.to(torch.float32).contiguous()
    settings = (float(betas[0]), float(betas[1]), float(eps), float(bias1), float(bias2))
    mask = None if seen is None else seen.view(torch.uint8)
    if backend != "cpu":
        columns = [rate] * width if rates is None else rates.tolist()
        _on_card(backend, rows, width, active, arrays, mask, columns, settings)
        return
    parallel("mgf_adam", rows, width, active, *arrays, mask, rate, rates, *settings)


def _on_card(
    backend: str,
    rows: int,
    width: int,
    active: int,
    arrays: list[Tensor],
    mask: Tensor | None,
    rates: list[float],
    settings: tuple[float, ...],
) -> None:
    from mgf_engine.native.cuda.launcher import blocks
    from mgf_engine.raster.cuda import launcher_on

    if width > _MOST_RATES:
        raise ValueError(f"rows of {width} numbers are longer than the {_MOST_RATES} the CUDA kernel takes")
    by_column = tuple(float(r) for r in rates) + (0.0,) * (_MOST_RATES - width)
    grid = blocks(rows * width)
    launcher_on(backend).launch("adam", grid, rows, width, active, *arrays, mask, by_column, settings)


def _reference(
    parameter: Tensor,
    gradient: Tensor,
    exp_avg: Tensor,
    exp_avg_sq: Tensor,
    lr: float | Tensor,
    betas: tuple[float, float],
    eps: float,
    bias1: float,
    bias2: float,
    visible: Tensor | None,
    active: int,
) -> None:
    rows, width = len(parameter), parameter.shape[1:].numel()
    seen = torch.ones(rows, dtype=torch.bool) if visible is None else visible
    p, g, m, v = (t.detach().view(rows, width)[:, :active] for t in (parameter, gradient, exp_avg, exp_avg_sq))
    rate = lr[:active] if isinstance(lr, Tensor) else lr
    m[seen] = betas[0] * m[seen] + (1 - betas[0]) * g[seen]
    v[seen] = betas[1] * v[seen] + (1 - betas[1]) * g[seen] ** 2
    p[seen] -= rate * m[seen] * bias1 / (torch.sqrt(v[seen] * bias2) + eps)
