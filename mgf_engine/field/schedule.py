# SPDX-License-Identifier: GPL-3.0-or-later
"""Schedule of the training: resolution, loss terms and learning rates as functions of the share of the run."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch

from mgf_engine.options.algorithms import parameter
from mgf_engine.options.config import job_option

#: Time of an iteration at each reduction of the resolution, relative to full resolution (measured): part of the work
#: does not depend on pixels. For the time left only.
_COST = {4: 0.25, 2: 0.4, 1: 1.0}


@dataclass(frozen=True)
class ScheduleOptions:
    """When the terms of the training act and at which resolution, as shares of the run."""

    quarter_until: float = parameter(0.15, "Share of the training on photos reduced four times", high=1)
    half_until: float = parameter(0.45, "Share of the training after which photos are no longer reduced", high=1)
    smallest_side: int = parameter(160, "Longest side below which photos are not reduced", "px")
    sh_degree_steps: int = parameter(
        10,
        "Number of equal parts of the training, each of which adds a degree of the spherical harmonics",
        low=1,
    )
    coarse_to_fine: bool = job_option("coarse_to_fine")
    sh_degree: int = job_option("sh_degree")
    geometry_from: float = job_option("geometry_from")
    geometry_every: int = job_option("geometry_every")


@dataclass(frozen=True)
class LearningRates:
    """Adam's step per parameter kind, in units of the normalised frame; positions fall exponentially."""

    positions: float = parameter(1.0e-3, "Learning rate of the positions, at the start", low=1e-12)
    positions_final: float = parameter(1.0e-5, "Learning rate of the positions, at the end", low=1e-12)
    by_extent: bool = parameter(
        False, "Give the learning rates of the positions in units of the scene's extent, as 3DGS does"
    )
    log_scales: float = parameter(7.0e-3, "Learning rate of the logarithms of the radii")
    rotations: float = parameter(2.0e-3, "Learning rate of the rotations (quaternions)")
    opacity_logits: float = parameter(5.0e-2, "Learning rate of the logits of the opacities")
    sh_constant: float = parameter(4.0e-3, "Learning rate of the colour", low=1e-12)
    sh_rest: float = parameter(2.0e-4, "Learning rate of the view-dependent colour (spherical harmonics)")
    decay_from: float = parameter(
        0.6, "Share of the training after which all learning rates but that of the positions fall linearly", high=0.999
    )
    decay_to: float = parameter(0.2, "Factor on the decaying learning rates at the end of the training", high=1)
    largest_scale: float = parameter(2.0, "Maximum factor on the learning rates of a run shorter than usual", low=1)

    def for_extent(self, extent: float) -> LearningRates:
        """Return these rates with those of the positions in units of the normalised frame."""
        if not self.by_extent:
            return self
        positions, final = self.positions * extent, self.positions_final * extent
        return replace(self, positions=positions, positions_final=final, by_extent=False)


def lr_scale_of(iterations: int, usual: int, rates: LearningRates = LearningRates()) -> float:
    """Return the factor on the learning rates of a run of ``iterations`` where ``usual`` iterations are the default.

    A shorter run must move parameters as far in fewer steps. The steps alternate with the photos like a random walk,
    whose distance grows with the square root of their number. Longer runs keep the usual rates.
    """
    return min(max(usual / max(iterations, 1), 1.0) ** 0.5, rates.largest_scale)


def rates_at(share: float, lr_scale: float = 1.0, rates: LearningRates = LearningRates()) -> dict[str, float]:
    """Return the learning rate per parameter name at a share of the run (0..1), all times ``lr_scale``."""
    positions = rates.positions * (rates.positions_final / rates.positions) ** share
    decay = 1.0 - (1.0 - rates.decay_to) * max(share - rates.decay_from, 0.0) / (1.0 - rates.decay_from)
    result = {
        "positions": positions,
        "log_scales": rates.log_scales * decay,
        "rotations": rates.rotations * decay,
        "opacity_logits": rates.opacity_logits * decay,
        "sh": rates.sh_constant * decay,
    }
    return {name: lr_scale * rate for name, rate in result.items()}


def reduction_at(share: float, longest_side: int, options: ScheduleOptions = ScheduleOptions()) -> int:
    """Return the factor that photos are reduced by at a share of the run: 4, 2 or 1.

    Args:
        share: of the iterations, 0..1.
        longest_side: of the working photos, px.
        options: of the schedule.
    """
    if not options.coarse_to_fine:
        return 1
    for factor, until in ((4, options.quarter_until), (2, options.half_until)):
        if share < until and longest_side / factor >= options.smallest_side:
            return factor
    return 1


def work_at(share: float, longest_side: int, options: ScheduleOptions = ScheduleOptions()) -> float:
    """Return the share of the run's time that has passed at a share of its iterations, 0..1.

    Args:
        share, longest_side, options: see :func:`reduction_at`.
    """

    def work(until: float) -> float:
        total, start = 0.0, 0.0
        for end in sorted((options.quarter_until, options.half_until, 1.0)):
            stop = min(end, until)
            if stop > start:
                total += (stop - start) * _COST[reduction_at(start, longest_side, options)]
                start = stop
        return total

    return work(share) / work(1.0)


def geometry_at(iteration: int, share: float, options: ScheduleOptions = ScheduleOptions()) -> float:
    """Return the factor on the distortion and normal terms at an iteration and its share of the run.

    Their maps and gradients are a quarter of an iteration's time. Applied in every third iteration with three times
    the weight they have the same mean, and the mesh is as good (docs/decisions/021-draft-preset.md).
    """
    acts = share >= options.geometry_from and iteration % options.geometry_every == 0
    return float(options.geometry_every) if acts else 0.0


def sh_degree_at(share: float, options: ScheduleOptions = ScheduleOptions()) -> int:
    """Return the degree of the spherical harmonics at a share of the run: constant colour first."""
    return min(options.sh_degree, int(share * options.sh_degree_steps))


def view_order(count: int, epoch: int, seed: int) -> list[int]:
    """Return a fixed shuffle of the training views for one pass over them."""
    generator = torch.Generator().manual_seed(seed * 1_000_003 + epoch)
    return torch.randperm(count, generator=generator).tolist()


def covers_all_views(first: int, last: int, count: int, seed: int) -> bool:
    """Tell whether each of ``count`` training views has a turn in iterations ``first`` to ``last`` - 1.

    Args:
        first: the first iteration.
        last: one past the last iteration.
        count: number of training views.
        seed: of the order of the views.
    """
    orders = {epoch: view_order(count, epoch, seed) for epoch in range(first // count, (last - 1) // count + 1)}
    return len({orders[i // count][i % count] for i in range(first, last)}) == count
