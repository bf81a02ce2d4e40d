# SPDX-License-Identifier: GPL-3.0-or-later
"""Densification and pruning: split the Gaussians with the largest colour error, prune those that no view needs.

A Gaussian answers for the error of the pixels it paints, in proportion to its blending weight. Every round the
ones that answer for most are split along their longest axis, within the budget of the moment; the faint, the
unseen and those the masks vote against are dropped.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from mgf_engine.field.optimiser import Optimiser
from mgf_engine.geometry.morton import along_curve
from mgf_engine.model.gaussians import Gaussians, rotation_matrices
from mgf_engine.options.algorithms import parameter
from mgf_engine.options.config import job_option
from mgf_engine.raster.api import RenderStats


@dataclass(frozen=True)
class DensificationOptions:
    """Options of one round of densification and pruning."""

    growth: float = parameter(0.25, "Share by which the number of Gaussians grows at most")
    least_error: float = parameter(0.1, "Summed colour error per view above which a Gaussian is split")
    largest: float = parameter(2.0, "Maximum radius of a Gaussian in units of the normalised frame")
    split_offset: float = parameter(0.55, "Distance of the children from the parent, as a share of its longest axis")
    split_shrink: float = parameter(
        0.62, "Length of the children along that axis, as a share of the parent's", low=0.01
    )
    vote_every: int = parameter(5, "Number of rounds between two votes of the masks on the Gaussians", low=1)
    max_gaussians: int = job_option("max_gaussians")
    densify_from: float = job_option("densify_from")
    densify_until: float = job_option("densify_until")
    densify_every: int = job_option("densify_every")
    prune_opacity: float = job_option("prune_opacity")
    use_votes: bool = job_option("training_votes")


@dataclass(frozen=True)
class DensifyResult:
    """What one round did."""

    added: int
    pruned: int


def densify_and_prune(
    optimiser: Optimiser,
    stats: RenderStats,
    keep: Tensor,
    budget: int,
    grow: bool,
    options: DensificationOptions = DensificationOptions(),
    prune_unseen: bool = True,
) -> DensifyResult:
    """Prune Gaussians and, if ``grow``, split others; rows may change places.

    Args:
        optimiser: holds the field; its moments move with the rows.
        stats: gathered since the last round, rows as in the optimiser's field.
        keep: bool [N]; false for Gaussians the masks vote against.
        budget: maximum number of Gaussians after the round.
        grow: split Gaussians; otherwise only prune.
        options: of growth and pruning.
        prune_unseen: drop Gaussians that no rendering since the last round showed; not where a view had no turn.
    """
    field = optimiser.field
    seen = stats.count > 0
    with torch.no_grad():
        alive = keep & (field.opacities > options.prune_opacity) & (field.scales.amax(1) < options.largest)
        if prune_unseen and bool(seen.any()):
            alive &= seen
        score = stats.error / stats.count.clamp_min(1)
    pruned = int((~alive).sum())
    optimiser.keep(alive)
    score = score[alive]
    growth = min(budget - len(optimiser.field), int(options.growth * len(optimiser.field)))
    if not grow or growth <= 0:
        return DensifyResult(0, pruned)
    chosen = torch.topk(score, min(growth, len(score))).indices
    chosen = chosen[score[chosen] > options.least_error]
    if len(chosen) == 0:
        return DensifyResult(0, pruned)
    children = split(optimiser.field.select(chosen), options)
    rest = torch.ones(len(optimiser.field), dtype=torch.bool, device=chosen.device)
    rest[chosen] = False
    optimiser.keep(rest)
    optimiser.append(children)
    # Gaussians of one tile in one place in memory: an iteration takes 4 % less than with children at the end.
    optimiser.keep(torch.from_numpy(along_curve(optimiser.field.positions.cpu().numpy())).to(chosen.device))
    return DensifyResult(len(chosen), pruned)


def split(parents: Gaussians, options: DensificationOptions = DensificationOptions()) -> Gaussians:
    """Split each parent into two children, apart along its longest axis and narrower along it; [2N]."""
    scales = torch.exp(parents.log_scales)
    longest = scales.argmax(1)
    rows = torch.arange(len(parents), device=scales.device)
    axis = rotation_matrices(parents.rotations)[rows, :, longest]
    offset = options.split_offset * scales[rows, longest][:, None] * axis
    log_scales = parents.log_scales.clone()
    log_scales[rows, longest] += float(torch.log(torch.tensor(options.split_shrink)))

    def twice(x: Tensor) -> Tensor:
        return torch.cat([x, x])

    return Gaussians(
        positions=torch.cat([parents.positions - offset, parents.positions + offset]),
        log_scales=twice(log_scales),
        rotations=twice(parents.rotations),
        opacity_logits=twice(parents.opacity_logits),
        sh=twice(parents.sh),
        filter_3d=twice(parents.filter_3d),
    )


def budget_at(share: float, start: int, options: DensificationOptions = DensificationOptions()) -> int:
    """Return the maximum number of Gaussians at a share of the run: from ``start`` up to the maximum."""
    span = max(options.densify_until - options.densify_from, 1e-6)
    grown = min(max((share - options.densify_from) / span, 0.0), 1.0)
    first = min(start, options.max_gaussians)
    return int(first * (options.max_gaussians / first) ** grown)
