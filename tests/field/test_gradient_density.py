# SPDX-License-Identifier: GPL-3.0-or-later
from dataclasses import replace

import numpy as np
import pytest
import torch
from support.analytic import camera

from mgf_engine.field.gradient_density import (
    GradientDensityOptions,
    mask_share,
    refine_by_gradient,
    reset_opacities,
    scene_extent,
    split_at_random,
)
from mgf_engine.field.optimiser import Optimiser
from mgf_engine.model.gaussians import Gaussians, rotation_matrices
from mgf_engine.raster.api import RenderStats

EXTENT, COUNT = 2.0, 10
BY_GRADIENT = GradientDensityOptions(by="gradient", prune_opacity=0.05, max_gaussians=1000)


def gaussians(radius: float = 0.01) -> Gaussians:
    """Small enough to be cloned: 1 % of the extent is 0.02."""
    random = torch.Generator().manual_seed(0)
    return Gaussians(
        positions=torch.randn(COUNT, 3, generator=random),
        log_scales=torch.full((COUNT, 3), float(np.log(radius))),
        rotations=torch.randn(COUNT, 4, generator=random),
        opacity_logits=torch.zeros(COUNT),
        sh=torch.zeros(COUNT, 16, 3),
        filter_3d=torch.zeros(COUNT),
    )


def pulled(*rows: int, length: float = 3e-4) -> RenderStats:
    """Statistics of four views in which some Gaussians are pulled by ``length`` on average."""
    stats = RenderStats.zeros(COUNT)
    stats.count += 4
    stats.gradient[list(rows)] = 4 * length
    return stats


def refined(field: Gaussians, stats: RenderStats, options: GradientDensityOptions = BY_GRADIENT, pooled: float = 1.0):
    optimiser = Optimiser(field)
    for first, _ in optimiser.moments.values():
        first += 1
    everything = torch.ones(len(field), dtype=torch.bool)
    return optimiser, refine_by_gradient(
        optimiser, stats, everything, EXTENT, pooled, torch.Generator().manual_seed(0), options
    )


def copies(field: Gaussians, place: torch.Tensor) -> int:
    return int((field.positions == place).all(1).sum())


def test_a_small_gaussian_is_cloned_and_the_clone_has_no_moments() -> None:
    field = gaussians()
    optimiser, result = refined(field, pulled(3))
    assert (result.added, result.pruned, len(optimiser.field)) == (1, 0, COUNT + 1)
    assert copies(optimiser.field, field.positions[3]) == 2
    here = (optimiser.field.positions == field.positions[3]).all(1)
    assert optimiser.moments["sh"][0][here][:, 0, 0].sort().values.tolist() == [0, 1]
    torch.testing.assert_close(optimiser.field.log_scales, field.log_scales[:1].expand(COUNT + 1, 3))


def test_a_large_gaussian_is_split_in_two_smaller_ones_that_replace_it() -> None:
    field = gaussians()
    field.log_scales[3, 1] = float(np.log(0.1))
    optimiser, result = refined(field, pulled(3))
    assert (result.added, len(optimiser.field)) == (1, COUNT + 1)
    assert copies(optimiser.field, field.positions[3]) == 0
    largest = optimiser.field.log_scales.exp().amax(1).sort().values[-2:]
    torch.testing.assert_close(largest, torch.full((2,), 0.1 / 1.6))


def test_what_is_not_pulled_stays_as_it_is() -> None:
    optimiser, result = refined(gaussians(), pulled(3, length=1.9e-4))
    assert (result.added, result.pruned, len(optimiser.field)) == (0, 0, COUNT)


def test_the_threshold_is_of_a_loss_over_the_frame() -> None:
    assert refined(gaussians(), pulled(3), pooled=0.5)[1].added == 0
    assert refined(gaussians(), pulled(3, length=4.1e-4), pooled=0.5)[1].added == 1
    half = np.zeros((4, 6), np.uint8)
    half[:2] = 1
    assert mask_share([half, np.ones((4, 6), np.uint8)]) == pytest.approx(0.75)


def test_by_absolute_values_as_many_are_chosen_but_others() -> None:
    field, stats = gaussians(), pulled(3, 4)
    stats.absolute_gradient += torch.arange(COUNT, dtype=torch.float32)
    optimiser, result = refined(field, stats, replace(BY_GRADIENT, by="absolute_gradient"))
    assert result.added == 2
    assert [copies(optimiser.field, place) for place in field.positions] == [1] * 8 + [2] * 2


def test_those_pulled_most_come_first_where_there_is_little_room() -> None:
    field, stats = gaussians(), pulled(3, 4, 5)
    stats.gradient[4] *= 2
    optimiser, result = refined(field, stats, replace(BY_GRADIENT, max_gaussians=COUNT + 1))
    assert (result.added, copies(optimiser.field, field.positions[4])) == (1, 2)


def test_the_faint_the_huge_and_the_outvoted_are_pruned_and_not_copied() -> None:
    field = gaussians()
    field.opacity_logits[0] = -10
    field.log_scales[1] = float(np.log(0.11 * EXTENT))
    optimiser, result = refined(field, pulled(0))
    assert (result.added, result.pruned, len(optimiser.field)) == (0, 2, COUNT - 2)
    keep = torch.arange(COUNT) > 0
    optimiser = Optimiser(gaussians())
    generator = torch.Generator()
    assert refine_by_gradient(optimiser, pulled(0), keep, EXTENT, 1.0, generator, BY_GRADIENT).added == 0
    assert len(optimiser.field) == COUNT - 1


def test_children_are_distributed_as_their_parent() -> None:
    parent = gaussians().select(torch.tensor([3]))
    parent.log_scales = torch.log(torch.tensor([[0.5, 0.1, 0.02]]))
    many = parent.select(torch.zeros(4000, dtype=torch.int64))
    children = split_at_random(many, torch.Generator().manual_seed(0), 1.6)
    local = (children.positions - parent.positions) @ rotation_matrices(parent.rotations)[0]
    torch.testing.assert_close(local.std(0), torch.tensor([0.5, 0.1, 0.02]), rtol=0.05, atol=0)
    assert (local.mean(0).abs() < 0.05 * local.std(0)).all()
    assert len(children) == 8000


def test_after_a_reset_nothing_is_above_its_opacity() -> None:
    field = gaussians()
    field.filter_3d += 0.01
    field.opacity_logits[2] = -8
    optimiser = Optimiser(field)
    optimiser.moments["opacity_logits"][0].add_(1)
    before = field.opacities[2].clone()
    reset_opacities(optimiser, 0.01)
    expected = torch.full((COUNT,), 0.01)
    expected[2] = before
    torch.testing.assert_close(optimiser.field.opacities, expected)
    assert float(optimiser.moments["opacity_logits"][0].sum()) == 0


def test_the_extent_is_the_radius_of_the_cameras_and_a_tenth_more() -> None:
    views = [camera(place) for place in ([3.0, 0, 0.1], [-3.0, 0, 0.1], [0, 2.0, 0.1], [0, -2.0, 0.1])]
    assert scene_extent(views) == pytest.approx(3.3)
