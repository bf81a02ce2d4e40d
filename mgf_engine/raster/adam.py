# SPDX-License-Identifier: GPL-3.0-or-later
"""The Adam step (Kingma & Ba, 2015), fused, for the rows of a parameter that the last view saw."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from mgf_engine.native.library import parallel
from mgf_engine.raster.device import backend_for

_MOST_RATES = 48  # csrc/cuda/adam.cu


@dataclass(frozen=True)
class AdamStep:
    """How far one step goes.

    Attributes:
        lr: learning rate, or one per number of a row, float32 [W] on the CPU.
        number: of this step, from 1.
        betas: decay rates b1, b2 of the moments.
        eps: added to the root of the second moment.
    """

    lr: float | Tensor
    number: int
    betas: tuple[float, float] = (0.9, 0.999)
    eps: float = 1e-15

    @property
    def bias_corrections(self) -> tuple[float, float]:
        """1 / (1 - b^step) of both moments."""
        return 1 / (1 - self.betas[0] ** self.number), 1 / (1 - self.betas[1] ** self.number)


def adam_step(
    parameter: Tensor,
    gradient: Tensor,
    moments: tuple[Tensor, Tensor],
    step: AdamStep,
    visible: Tensor | None = None,
    *,
    active: int | None = None,
    backend: str | None = None,
) -> None:
    """Take one step in place: ``p -= lr * m / (1 - b1^step) / (sqrt(v / (1 - b2^step)) + eps)``.

    Args:
        parameter: float32 [N, ...], contiguous; a row is everything behind the first axis, W numbers.
        gradient: as ``parameter``.
        moments: first and second moment m, v, each as ``parameter``; changed.
        step: rates and number of the step.
        visible: bool [N]; other rows and their moments stay as they are. None: all rows.
        active: number of leading columns of each row that are updated. None: all.
        backend: ``cpu``, ``cuda``, ``cuda-source-on-cpu`` or ``reference`` (plain torch). None: ``cuda`` for parameters
            on a GPU, else ``cpu``.

    Raises:
        ValueError: a tensor is not float32 or has another shape, or there are too many rates or not one for each
            number.
    """
    backend = backend_for(parameter, backend)
    rows, width, lr = len(parameter), parameter.shape[1:].numel(), step.lr
    active = width if active is None else active
    seen = None if visible is None else visible.to(torch.bool).contiguous()
    if backend == "reference":
        _reference_step(parameter, gradient, moments, step, seen, active)
        return
    arrays = [t.detach() for t in (parameter, gradient.contiguous(), *moments)]
    if any(t.dtype != torch.float32 or t.numel() != rows * width for t in arrays):
        raise ValueError("parameter, gradient and moments must be float32 of one shape")
    if isinstance(lr, Tensor) and lr.numel() != width:
        raise ValueError(f"lr has {lr.numel()} rates for rows of {width} numbers")
    uniform = not isinstance(lr, Tensor) or bool((lr == lr[0]).all())  # whole stretches of rows in one loop
    rate = float(lr[0]) if isinstance(lr, Tensor) else float(lr)
    rates = None if uniform or not isinstance(lr, Tensor) else lr.to(torch.float32).contiguous()
    settings = tuple(float(v) for v in (*step.betas, step.eps, *step.bias_corrections))
    mask = None if seen is None else seen.view(torch.uint8)
    if backend != "cpu":
        columns = [rate] * width if rates is None else rates.tolist()
        _step_on_gpu(backend, arrays, mask, active, columns, settings)
        return
    parallel("mgf_adam", rows, width, active, *arrays, mask, rate, rates, *settings)


def _step_on_gpu(
    backend: str,
    arrays: list[Tensor],
    mask: Tensor | None,
    active: int,
    rates: list[float],
    settings: tuple[float, ...],
) -> None:
    """Take the step by the CUDA kernel.

    Args:
        backend: ``cuda`` or ``cuda-source-on-cpu``.
        arrays: parameter, gradient and both moments.
        mask: uint8 [N], rows that are updated; None for all.
        active: number of leading columns that are updated.
        rates: learning rate of each column.
        settings: decay rates, eps and bias corrections, as the kernel takes them.

    Raises:
        ValueError: rows are longer than the kernel takes.
    """
    from mgf_engine.native.cuda.launcher import blocks
    from mgf_engine.raster.cuda import launcher_on

    rows, width = len(arrays[0]), len(rates)
    if width > _MOST_RATES:
        raise ValueError(f"rows of {width} numbers are longer than the {_MOST_RATES} the CUDA kernel takes")
    by_column = tuple(float(r) for r in rates) + (0.0,) * (_MOST_RATES - width)
    grid = blocks(rows * width)
    launcher_on(backend).launch("adam", grid, rows, width, active, *arrays, mask, by_column, settings)


def _reference_step(
    parameter: Tensor,
    gradient: Tensor,
    moments: tuple[Tensor, Tensor],
    step: AdamStep,
    visible: Tensor | None,
    active: int,
) -> None:
    """Take the step in plain torch, as :func:`adam_step`."""
    rows, width = len(parameter), parameter.shape[1:].numel()
    seen = torch.ones(rows, dtype=torch.bool) if visible is None else visible
    p, g, m, v = (t.detach().view(rows, width)[:, :active] for t in (parameter, gradient, *moments))
    (b1, b2), (bias1, bias2) = step.betas, step.bias_corrections
    rate = step.lr[:active] if isinstance(step.lr, Tensor) else step.lr
    m[seen] = b1 * m[seen] + (1 - b1) * g[seen]
    v[seen] = b2 * v[seen] + (1 - b2) * g[seen] ** 2
    p[seen] -= rate * m[seen] * bias1 / (torch.sqrt(v[seen] * bias2) + step.eps)
