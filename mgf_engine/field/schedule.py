# SPDX-License-Identifier: GPL-3.0-or-later
"""When things happen during training, always as a share of the run, and how learning rates fall."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from mgf_engine.algorithms import parameter
from mgf_engine.config import Config

#: Reduction of resolution and the share of the run until which it holds.
_LEVELS = ((4, 0.15), (2, 0.45), (1, 1.0))
#: Time of an iteration at each reduction, beside one at full resolution; a part of the work does not depend on pixels.
_COST = {4: 0.25, 2: 0.4, 1: 1.0}
_MAX_LR_SCALE = 2.0  # more was not tried
_SMALLEST_SIDE = 160  # px; no level makes the longest side shorter than this


@dataclass(frozen=True)
class LearningRates:
    """Adam's step per parameter kind, in units of the normalised frame; positions fall exponentially."""

    positions: float = parameter(1.0e-3, "Learning rate of the positions, at the start", low=1e-12)
    positions_final: float = parameter(1.0e-5, "Learning rate of the positions, at the end", low=1e-12)
    log_scales: float = parameter(7.0e-3, "Learning rate of the logarithms of the radii")
    rotations: float = parameter(2.0e-3, "Learning rate of the rotations (quaternions)")
    opacity_logits: float = parameter(5.0e-2, "Learning rate of the logits of the opacities")
    sh_constant: float = parameter(4.0e-3, "Learning rate of the colour", low=1e-12)
    sh_rest: float = parameter(2.0e-4, "Learning rate of the view-dependent colour (spherical harmonics)")


def lr_scale_of(iterations: int, usual: int) -> float:
    """Factor on the learning rates of a run of so many iterations, where so many are usual.

    A run cut short must go as far in fewer steps, which go to and fro with the photos: a walk of n random steps goes
    as far as the root of n of them. Longer runs keep the usual rates.
    """
    return min(max(usual / max(iterations, 1), 1.0) ** 0.5, _MAX_LR_SCALE)


def rates_at(share: float, lr_scale: float = 1.0, rates: LearningRates = LearningRates()) -> dict[str, float]:
    """Learning rate per parameter name at a share of the run (0..1), all times ``lr_scale``."""
    positions = rates.positions * (rates.positions_final / rates.positions) ** share
    decay = 1.0 if share < 0.6 else 1.0 - 0.8 * (share - 0.6) / 0.4
    result = {
        "positions": positions,
        "log_scales": rates.log_scales * decay,
        "rotations": rates.rotations * decay,
        "opacity_logits": rates.opacity_logits * decay,
        "sh": rates.sh_constant * decay,
    }
    return {name: lr_scale * rate for name, rate in result.items()}


def reduction_at(share: float, longest_side: int, config: Config) -> int:
    """By how much photos are reduced at a share of the run: 4, 2 or 1."""
    if not config.coarse_to_fine:
        return 1
    for factor, until in _LEVELS:
        if share < until and longest_side / factor >= _SMALLEST_SIDE:
            return factor
    return 1


def work_at(share: float, longest_side: int, config: Config) -> float:
    """Share of the run's time that has gone at a share of its iterations, 0..1: small pictures are quick."""

    def work(until: float) -> float:
        total, start = 0.0, 0.0
        for _, end in _LEVELS:
            stop = min(end, until)
            if stop > start:
                total += (stop - start) * _COST[reduction_at(start, longest_side, config)]
                start = stop
        return total

    return work(share) / work(1.0)


def geometry_at(iteration: int, share: float, config: Config) -> float:
    """Factor on the distortion and normal terms, at an iteration and its share of the run.

    Their maps and gradients are a quarter of an iteration's time. In every third one with three times the weight they
    say the same on average, and the mesh is as good (docs/decisions/021-draft-preset.md).
    """
    acts = share >= config.geometry_from and iteration % config.geometry_every == 0
    return float(config.geometry_every) if acts else 0.0


def sh_degree_at(share: float, config: Config) -> int:
    """Degree of the spherical harmonics: constant colour first, one more every tenth of the run."""
    return min(config.sh_degree, int(share * 10))


def view_order(count: int, epoch: int, seed: int) -> list[int]:
    """A fixed shuffle of the training views for one pass over them."""
    generator = torch.Generator().manual_seed(seed * 1_000_003 + epoch)
    return torch.randperm(count, generator=generator).tolist()
