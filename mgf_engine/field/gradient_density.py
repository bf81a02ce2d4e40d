# SPDX-License-Identifier: GPL-3.0-or-later
"""Adaptive density control by the gradient of the projected centre (3DGS, section 5.2; GOF).

Where a Gaussian is pulled across the picture, geometry is missing: a small one is cloned, a large one split in two.
3DGS adds the gradients of a view's pixels and takes the length of the sum, in which pixels that pull apart cancel; GOF
adds their lengths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mgf_engine.field.density import DensifyResult
from mgf_engine.field.optimiser import Optimiser
from mgf_engine.geometry.morton import along_curve
from mgf_engine.model.gaussians import Gaussians, rotation_matrices
from mgf_engine.model.masks import building
from mgf_engine.model.scene import View
from mgf_engine.options.algorithms import parameter
from mgf_engine.options.config import job_option
from mgf_engine.raster.api import RenderStats


@dataclass(frozen=True)
class GradientDensityOptions:
    """Options of densification by the gradient of the projected centre."""

    threshold: float = parameter(
        2e-4,
        "Mean length of the gradient above which a Gaussian is cloned or split, of a loss that is a mean over the "
        "frame, by normalised device coordinates",
        low=1e-12,
    )
    clone_below: float = parameter(
        0.01, "Largest radius up to which a Gaussian is cloned and not split, as a share of the scene's extent"
    )
    split_shrink: float = parameter(1.6, "Divisor of the radii of the two children of a split", low=1)
    largest: float = parameter(0.1, "Maximum radius of a Gaussian, as a share of the scene's extent", low=1e-3)
    reset_every: int = parameter(0, "Number of iterations between two resets of the opacities; 0 for none")
    reset_opacity: float = parameter(0.01, "Maximum opacity after a reset", low=1e-4, high=1)
    by: str = job_option("densify_by")
    prune_opacity: float = job_option("prune_opacity")
    max_gaussians: int = job_option("max_gaussians")


def scene_extent(views: Sequence[View]) -> float:
    """Compute the radius of the sphere around the mean of the camera centres that holds them all, and a tenth more."""
    centres = np.stack([view.centre for view in views])
    return 1.1 * float(np.linalg.norm(centres - centres.mean(0), axis=1).max())


def mask_share(labels: Sequence[NDArray[np.uint8]]) -> float:
    """Compute the mean share of the frame that the building's masks cover, over the label maps [H, W] of the views."""
    return float(np.mean([building(own).mean() for own in labels]))


def refine_by_gradient(
    optimiser: Optimiser,
    stats: RenderStats,
    keep: Tensor,
    extent: float,
    covered: float,
    generator: torch.Generator,
    options: GradientDensityOptions = GradientDensityOptions(by="gradient"),
) -> DensifyResult:
    """Clone and split the Gaussians that are pulled most, prune the faint and the huge; rows may change places.

    Args:
        optimiser: holds the field; its moments move with the rows, and those of new rows are zero.
        stats: gathered since the last round, rows as in the optimiser's field.
        keep: bool [N]; false for Gaussians the masks vote against.
        extent: of the scene, normalised frame (:func:`scene_extent`).
        covered: share of the frame that the loss is a mean over (:func:`mask_share`).
        generator: of the places of children.
        options: thresholds; ``max_gaussians`` bounds the number of Gaussians, those pulled most are chosen first.
    """
    with torch.no_grad():
        alive = keep & (optimiser.field.opacities >= options.prune_opacity)
        gradient, chosen = _pulled(stats, covered, options)
    chosen, gradient = chosen[alive], gradient[alive]
    optimiser.keep(alive)
    chosen &= _largest(gradient, chosen, options.max_gaussians - len(optimiser.field))
    with torch.no_grad():
        large = chosen & (optimiser.field.scales.amax(1) > options.clone_below * extent)
        clones, parents = optimiser.field.select(chosen & ~large), optimiser.field.select(large)
    optimiser.keep(~large)
    optimiser.append(clones)
    optimiser.append(split_at_random(parents, generator, options.split_shrink))
    added = len(clones) + len(parents)
    with torch.no_grad():
        small = optimiser.field.scales.amax(1) <= options.largest * extent
    optimiser.keep(small)
    # Gaussians of one tile in one place in memory, as in density.py.
    order = along_curve(optimiser.field.positions.cpu().numpy())
    optimiser.keep(torch.from_numpy(order).to(small.device))
    return DensifyResult(added, int((~alive).sum()) + int((~small).sum()))


def _pulled(stats: RenderStats, covered: float, options: GradientDensityOptions) -> tuple[Tensor, Tensor]:
    """Return what Gaussians are ranked by, float32 [N], and which of them are to be cloned or split, bool [N].

    Lengths per pixel have another scale than the length of the sum: as many Gaussians are chosen by the former as the
    threshold chooses by the latter.
    """
    views = stats.count.clamp_min(1)
    mean = stats.gradient / views
    chosen = mean * covered > options.threshold
    if options.by == "gradient":
        return mean, chosen
    absolute = stats.absolute_gradient / views
    return absolute, _largest(absolute, torch.ones_like(chosen), int(chosen.sum()))


def _largest(values: Tensor, among: Tensor, count: int) -> Tensor:
    """Mark the ``count`` largest values [N] among the marked ones, bool [N]; all of them where there are fewer."""
    count = min(max(count, 0), int(among.sum()))
    marked = torch.zeros_like(among)
    marked[torch.topk(torch.where(among, values, -1.0), count).indices] = True
    return marked


def split_at_random(parents: Gaussians, generator: torch.Generator, shrink: float) -> Gaussians:
    """Make two children of each parent, drawn from it as a distribution and smaller by ``shrink``; [2N]."""
    twice = parents.select(torch.arange(len(parents), device=parents.positions.device).repeat(2))
    drawn = torch.randn(len(twice), 3, generator=generator).to(twice.positions.device) * twice.scales
    offset = (rotation_matrices(twice.rotations) @ drawn[:, :, None]).squeeze(2)
    return replace(twice, positions=twice.positions + offset, log_scales=twice.log_scales - float(np.log(shrink)))


def reset_opacities(optimiser: Optimiser, highest: float) -> None:
    """Lower all opacities to ``highest`` at most and forget their moments: what no photo needs stays faint."""
    field = optimiser.field
    with torch.no_grad():
        fused = field.opacities
        ratio = fused / torch.sigmoid(field.opacity_logits).clamp_min(1e-30)
        lowered = torch.logit((highest / ratio.clamp_min(1e-30)).clamp(1e-6, 1 - 1e-6))
        field.opacity_logits = torch.where(fused > highest, lowered, field.opacity_logits)
    for moment in optimiser.moments["opacity_logits"]:
        moment.zero_()
