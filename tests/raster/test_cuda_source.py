# SPDX-License-Identifier: GPL-3.0-or-later
"""The CUDA sources built for the CPU: what the suite of all backends does not look at."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from rendered import OUTPUTS, Result, camera, gaussians, random_weights, run, skip_without_gpu
from support.tile_lists import check_lists

from mgf_engine.model.gaussians import Gaussians
from mgf_engine.native.cuda.emulated import SourceOnCpu
from mgf_engine.native.cuda.launcher import At, pack
from mgf_engine.native.cuda.sources import program_of, programs
from mgf_engine.raster import reference
from mgf_engine.raster.api import render
from mgf_engine.raster.cpu import Parameters
from mgf_engine.raster.cuda import launcher_on, rasterizer_on

SOURCE = "cuda-source-on-cpu"


@pytest.fixture
def source() -> Iterator[SourceOnCpu]:
    launcher = launcher_on(SOURCE)
    assert isinstance(launcher, SourceOnCpu)
    yield launcher
    launcher.reverse = False


def once() -> Result:
    field, view = gaussians(400, seed=2, log_scale=-2.2), camera(70, 50, focal=60.0)
    weights = random_weights(view, OUTPUTS, 0, torch.ones(50, 70))
    return run(field, view, SOURCE, weights, torch.ones(50, 70), sh_degree=2)


def test_order_of_threads_and_blocks_changes_no_bit(source: SourceOnCpu) -> None:
    """Threads of a phase that depended on each other would give other numbers when they run backwards."""
    forwards = once()
    source.reverse = True
    backwards = once()
    for name in OUTPUTS:
        assert torch.equal(getattr(forwards.rendering, name), getattr(backwards.rendering, name)), name
    for name, gradient in forwards.gradients.items():
        assert torch.equal(gradient, backwards.gradients[name]), name
    for a, b in zip(forwards.stats.all, backwards.stats.all, strict=True):
        assert torch.equal(a, b)


@pytest.mark.parametrize("n", [0, 1, 31, 1023, 1024, 1025, 5000])
@pytest.mark.parametrize("bits", [3, 8, 13, 32])
@pytest.mark.parametrize("where", [SOURCE, "backwards", "cuda"])
def test_sort_is_stable(source: SourceOnCpu, n: int, bits: int, where: str) -> None:
    skip_without_gpu(where)
    source.reverse = where == "backwards"
    rasterizer = rasterizer_on("cuda" if where == "cuda" else SOURCE)
    high = min(2**bits, 2**32) if bits < 32 else 2**32
    keys = np.random.default_rng(n).integers(0, high, n, dtype=np.uint64).astype(np.uint32)
    keys[n // 2 :] = keys[: n - n // 2]  # equal ones
    given = torch.from_numpy(keys.view(np.int32).copy()).to(rasterizer.launcher.device)
    found_keys, found = (t.cpu() for t in rasterizer.sort(given, None, bits))
    expected = np.argsort(keys, kind="stable")
    assert np.array_equal(found.numpy(), expected)
    assert np.array_equal(found_keys.numpy().view(np.uint32), keys[expected])


@pytest.mark.parametrize("backend", [SOURCE, "cuda"])
def test_sort_leaves_out_what_is_not_listed(backend: str) -> None:
    skip_without_gpu(backend)
    rasterizer = rasterizer_on(backend)
    keys = torch.arange(3000, 0, -1, dtype=torch.int32, device=rasterizer.launcher.device)
    listed = torch.tensor([1500], dtype=torch.int32, device=rasterizer.launcher.device)
    _, found = rasterizer.sort(keys, None, 16, listed)
    assert torch.equal(found[:1500].cpu(), torch.arange(1499, -1, -1, dtype=torch.int32))


@pytest.mark.parametrize("seed", range(6))
def test_lists_hold_all_that_shows(seed: int) -> None:
    field, view = gaussians(80, seed, log_scale=-2.5 + 0.4 * seed), camera(61, 40, seed=seed)
    field.log_scales[:, 2] -= seed % 3
    mask = torch.tensor([(0xB5D * (seed + 1)) >> i & 1 for i in range(12)]).view(3, 4)
    raw = Parameters.of_field(field)
    lists = rasterizer_on(SOURCE).list_tiles(raw, view, 0, mask)
    entries = int(lists.ranges[-1])
    starts = torch.cat([lists.slot_starts.long(), torch.tensor([entries])])
    seen = SimpleNamespace(
        tiles_x=lists.tiles_x, tiles_y=lists.tiles_y, ranges=lists.ranges, entries=entries, slot_starts=starts,
        tile_counts=lists.tile_counts, gid=lists.gid[:entries], records=lists.records, slots=lists.slots[:entries],
    )  # fmt: skip
    check_lists(seen, reference.touched_tiles(field, view), mask)


def test_renderings_side_by_side_are_those_one_by_one() -> None:
    """The mesh stage draws several views at once, from threads of its own."""
    view = camera(70, 50, focal=60.0)
    fields = [gaussians(300, seed=seed, log_scale=-2.2) for seed in range(4)]

    def draw(field: Gaussians) -> torch.Tensor:
        return render(field, view, sh_degree=1, backend=SOURCE).color

    alone = [draw(field) for field in fields]
    with ThreadPoolExecutor(4) as pool:
        for _ in range(5):
            for one, other in zip(alone, pool.map(draw, fields), strict=True):
                assert torch.equal(one, other)


def test_every_kernel_is_found_in_its_program() -> None:
    assert len(programs()) >= 10
    assert program_of("blend_backward_all_stats") == "blend_backward" and program_of("radix_scatter") == "sort"
    launcher = launcher_on(SOURCE)
    for names in programs().values():
        for name in names:
            launcher.launch(name, 0)  # an empty grid starts nothing


def test_arguments_are_packed_as_the_kernels_read_them() -> None:
    values = torch.zeros(4, 6)
    place, cpu = At(values[:, :3], 8), torch.device("cpu")
    addresses, kept = pack((7, 2.5, None, values, place, (values, 3, 1.5), b"abcd"), cpu)
    assert len(addresses) == len(kept) == 7
    assert kept[0].value == 7 and kept[1].value == 2.5 and kept[2].value is None
    assert kept[3].value == values.data_ptr() and kept[4].value == values.data_ptr() + 32
    assert len(kept[5]) == 16 and bytes(kept[6]) == b"abcd"
    with pytest.raises(ValueError, match="cannot read"):
        pack((values[:, :3],), cpu)
    with pytest.raises(ValueError, match="cannot read"):
        pack((values,), torch.device("cuda", 0))


@pytest.mark.parametrize("wrap", [lambda tensor: tensor, lambda tensor: (tensor, 1), lambda tensor: At(tensor, 0)])
def test_a_tensor_of_another_gpu_is_refused(wrap: Callable[[Any], Any]) -> None:
    class Elsewhere:
        device = torch.device("cuda", 1)

        def __getitem__(self, place: slice) -> Elsewhere:
            return self

        contiguous = is_contiguous = data_ptr = element_size = lambda self: self

    with pytest.raises(ValueError, match="kernel on cuda:0 was given a tensor on cuda:1"):
        pack((wrap(Elsewhere()),), torch.device("cuda", 0))
