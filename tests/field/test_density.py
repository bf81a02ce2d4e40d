# SPDX-License-Identifier: GPL-3.0-or-later
import math

import pytest
import torch

from mgf_engine.field.density import DensificationOptions, budget_at, densify_and_prune, split
from mgf_engine.field.optimiser import Optimiser
from mgf_engine.geometry.morton import along_curve
from mgf_engine.model.gaussians import Gaussians, rotation_matrices
from mgf_engine.raster.api import RenderStats


def gaussians(count: int = 20, seed: int = 0) -> Gaussians:
    random = torch.Generator().manual_seed(seed)
    return Gaussians(
        positions=torch.randn(count, 3, generator=random),
        log_scales=torch.randn(count, 3, generator=random) * 0.5 - 3,
        rotations=torch.randn(count, 4, generator=random),
        opacity_logits=torch.zeros(count),
        sh=torch.zeros(count, 16, 3),
        filter_3d=torch.zeros(count),
    )


def seen_stats(count: int) -> RenderStats:
    stats = RenderStats.zeros(count)
    stats.count += 1
    stats.error += torch.arange(count, dtype=torch.float32)
    return stats


def test_children_lie_along_the_longest_axis_and_are_narrower_there() -> None:
    parents = gaussians()
    children = split(parents)
    assert len(children) == 40
    middle = (children.positions[:20] + children.positions[20:]) / 2
    torch.testing.assert_close(middle, parents.positions)
    scales, longest = torch.exp(parents.log_scales), parents.log_scales.argmax(1)
    axis = rotation_matrices(parents.rotations)[torch.arange(20), :, longest]
    apart = children.positions[20:] - children.positions[:20]
    torch.testing.assert_close((apart * axis).sum(1).abs(), apart.norm(dim=1))
    child_scales = torch.exp(children.log_scales[:20])
    rows = torch.arange(20)
    assert bool((child_scales[rows, longest] < scales[rows, longest]).all())


def test_those_that_answer_for_most_error_are_split_within_the_budget() -> None:
    optimiser = Optimiser(gaussians())
    marked = optimiser.field.positions[-3:].clone()
    result = densify_and_prune(optimiser, seen_stats(20), torch.ones(20, dtype=torch.bool), 23, grow=True)
    assert (result.added, result.pruned, len(optimiser.field)) == (3, 0, 23)
    assert not any(bool((optimiser.field.positions == m).all(1).any()) for m in marked)
    for first, second in optimiser.moments.values():
        assert len(first) == len(second) == 23
    assert along_curve(optimiser.field.positions.numpy()).tolist() == list(range(23))


def test_what_belongs_to_a_gaussian_moves_with_it() -> None:
    optimiser = Optimiser(gaussians())
    tags = torch.arange(20.0)
    optimiser.field.opacity_logits[:] = tags / 100
    for first, _ in optimiser.moments.values():
        first.view(20, -1)[:] = tags[:, None]
    before = optimiser.field.positions.clone()
    densify_and_prune(optimiser, seen_stats(20), torch.ones(20, dtype=torch.bool), 22, grow=True)
    kept = [int((optimiser.field.positions == place).all(1).nonzero()) for place in before[:18]]
    assert kept != sorted(kept)  # they did change places
    torch.testing.assert_close(optimiser.field.opacity_logits[kept], tags[:18] / 100)
    for first, _ in optimiser.moments.values():
        torch.testing.assert_close(first[kept].reshape(18, -1)[:, 0], tags[:18])


def test_the_unseen_stay_where_a_view_had_no_turn() -> None:
    optimiser, stats = Optimiser(gaussians()), seen_stats(20)
    stats.count[1] = 0
    everything = torch.ones(20, dtype=torch.bool)
    assert densify_and_prune(optimiser, stats, everything, 100, grow=False, prune_unseen=False).pruned == 0
    assert densify_and_prune(optimiser, stats, everything, 100, grow=False).pruned == 1


def test_the_unseen_the_faint_and_the_outvoted_are_dropped() -> None:
    field = gaussians()
    field.opacity_logits[0] = -10
    stats = seen_stats(20)
    stats.count[1] = 0
    keep = torch.ones(20, dtype=torch.bool)
    keep[2] = False
    optimiser = Optimiser(field)
    result = densify_and_prune(optimiser, stats, keep, 100, grow=False)
    assert (result.added, result.pruned) == (0, 3)


def test_nothing_grows_where_the_picture_is_right() -> None:
    stats = seen_stats(20)
    stats.error.zero_()
    optimiser = Optimiser(gaussians())
    assert densify_and_prune(optimiser, stats, torch.ones(20, dtype=torch.bool), 100, grow=True).added == 0


@pytest.mark.parametrize(("share", "expected"), [(0.0, 1000), (0.9, 100_000)])
def test_budget_grows_from_the_start_to_the_maximum(share: float, expected: int) -> None:
    options = DensificationOptions(max_gaussians=100_000)
    assert math.isclose(budget_at(share, 1000, options), expected, rel_tol=1e-3)
    assert budget_at(0.2, 1000, options) <= budget_at(0.4, 1000, options)
    assert budget_at(0.5, 10**7, options) == 100_000
