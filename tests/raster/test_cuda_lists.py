# SPDX-License-Identifier: GPL-3.0-or-later
"""Tile lists where the kernel that counts entries and the one that writes them disagree by one, as two builds may."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import pytest
import torch
from rendered import camera, gaussians

from mgf_engine.native.cuda.emulated import SourceOnCpu
from mgf_engine.raster.api import Camera
from mgf_engine.raster.cpu import OutputGradients, Parameters
from mgf_engine.raster.cuda import launcher_on
from mgf_engine.raster.cuda.blending import Rasterizer, TileLists

STALE = 3  # what memory holds that nothing was written to: the number of a tile, so that reading it crashes nothing
SIZES = [(70, 50), (256, 256)]  # 20 tiles; 256 tiles, where the number after the last takes one bit more


class StaleMemory(Rasterizer):
    def empty(self, dtype: torch.dtype, *shape: int) -> torch.Tensor:
        return torch.full(shape, STALE, dtype=dtype, device=self.launcher.device)


@pytest.fixture(params=[False, True], ids=["forwards", "backwards"])
def rasterizer(request: pytest.FixtureRequest) -> Iterator[Rasterizer]:
    launcher = launcher_on("cuda-source-on-cpu")
    assert isinstance(launcher, SourceOnCpu)
    launcher.reverse = request.param
    yield StaleMemory(launcher)
    launcher.reverse = False


def field_and_view(size: tuple[int, int]) -> tuple[Parameters, Camera]:
    field = gaussians(150, seed=2, log_scale=-1.6)
    return Parameters.of_field(field), camera(*size, focal=0.9 * size[0])


def listed(rasterizer: Rasterizer, raw: Parameters, view: Camera, wrong: int, by: int) -> TileLists:
    """The lists when the count of Gaussian ``wrong`` is off by so many."""
    seen = rasterizer.project(raw, view, 1, None)
    seen.tile_counts[wrong] += by
    return rasterizer.bin_tiles(seen)


def tiles_of(lists: TileLists) -> list[list[int]]:
    """The Gaussians of each tile, front to back."""
    ranges = lists.ranges.tolist()
    assert ranges[0] == 0 and ranges == sorted(ranges) and ranges[-1] <= len(lists.gid)
    return [lists.gid[a:b].tolist() for a, b in pairwise(ranges)]


def spread_out(lists: TileLists) -> list[int]:
    """Gaussians in several tiles: the first in the order by depth, one in the middle and the last."""
    several = torch.nonzero(lists.tile_counts > 2).flatten()
    order = several[lists.slot_starts[several].argsort()].tolist()
    return [order[0], order[len(order) // 2], order[-1]]


@pytest.mark.parametrize("size", SIZES)
def test_a_count_too_large_leaves_a_slot_that_nobody_draws(rasterizer: Rasterizer, size: tuple[int, int]) -> None:
    raw, view = field_and_view(size)
    whole = rasterizer.list_tiles(raw, view, 1, None)
    for wrong in spread_out(whole):
        lists = listed(rasterizer, raw, view, wrong, 1)
        assert tiles_of(lists) == tiles_of(whole)
        assert len(lists.gid) == len(whole.gid) + 1 and int(lists.ranges[-1]) == len(whole.gid)
        image, hits = rasterizer.blend(lists, True)
        assert torch.equal(image, rasterizer.blend(whole, True)[0])
        assert hits[int(lists.slot_starts[wrong]) + int(lists.tile_counts[wrong]) - 1] == 0


@pytest.mark.parametrize("size", SIZES)
def test_a_count_too_small_costs_one_entry_and_no_neighbour(rasterizer: Rasterizer, size: tuple[int, int]) -> None:
    raw, view = field_and_view(size)
    whole = rasterizer.list_tiles(raw, view, 1, None)
    complete = tiles_of(whole)
    for wrong in spread_out(whole):
        lists = listed(rasterizer, raw, view, wrong, -1)
        last = max(tile for tile, here in enumerate(complete) if wrong in here)
        expected = [[g for g in here if (g, t) != (wrong, last)] for t, here in enumerate(complete)]
        assert tiles_of(lists) == expected
        image, all_of_it = rasterizer.blend(lists, True)[0], rasterizer.blend(whole, True)[0]
        y, x = divmod(last, lists.tiles_x)
        for picture in (image, all_of_it):
            picture[:, 16 * y : 16 * y + 16, 16 * x : 16 * x + 16] = 0
        assert torch.equal(image, all_of_it)


def test_gradients_do_not_see_a_slot_that_is_left_over(rasterizer: Rasterizer) -> None:
    raw, view = field_and_view(SIZES[0])
    whole = rasterizer.list_tiles(raw, view, 1, None)
    slope = torch.ones(3, view.height, view.width)
    outputs = OutputGradients(slope, None, None, None, None, None)

    def gradients(lists: TileLists) -> tuple[torch.Tensor, ...]:
        image, hits = rasterizer.blend(lists, True)
        return rasterizer.backward(raw, 1, lists, image, hits, outputs, None, None)

    expected = gradients(whole)
    for wrong in spread_out(whole):
        found = gradients(listed(rasterizer, raw, view, wrong, 1))
        assert all(torch.equal(a, b) for a, b in zip(expected, found, strict=True))
