# SPDX-License-Identifier: GPL-3.0-or-later
"""The CUDA sources built for the CPU: what the suite of all backends does not look at."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from rendered import OUTPUTS, Result, assert_agrees, camera, gaussians, leaves, random_weights, run
from test_projection import check_lists

from mgf_engine.field.gaussians import Gaussians
from mgf_engine.raster import reference
from mgf_engine.raster.api import RenderStats, render
from mgf_engine.raster.cpu import Parameters
from mgf_engine.raster.cuda import launcher_on, rasterizer_on
from mgf_engine.raster.cuda.blending import Rasterizer
from mgf_engine.raster.cuda.emulated import SourceOnCpu
from mgf_engine.raster.cuda.launching import At, pack
from mgf_engine.raster.cuda.room import Room
from mgf_engine.raster.cuda.sources import program_of, programs

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
@pytest.mark.parametrize("reverse", [False, True])
def test_sort_is_stable(source: SourceOnCpu, n: int, bits: int, reverse: bool) -> None:
    source.reverse = reverse
    high = min(2**bits, 2**32) if bits < 32 else 2**32
    keys = np.random.default_rng(n).integers(0, high, n, dtype=np.uint64).astype(np.uint32)
    keys[n // 2 :] = keys[: n - n // 2]  # equal ones
    given = torch.from_numpy(keys.view(np.int32).copy())
    found_keys, found = rasterizer_on(SOURCE).sort(given, None, bits)
    expected = np.argsort(keys, kind="stable")
    assert np.array_equal(found.numpy(), expected)
    assert np.array_equal(found_keys.numpy().view(np.uint32), keys[expected])


def test_sort_leaves_out_what_is_not_listed(source: SourceOnCpu) -> None:
    keys = torch.arange(3000, 0, -1, dtype=torch.int32)
    _, found = rasterizer_on(SOURCE).sort(keys, None, 16, torch.tensor([1500], dtype=torch.int32))
    assert torch.equal(found[:1500], torch.arange(1499, -1, -1, dtype=torch.int32))


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


def test_rendering_without_room_draws_nothing_and_the_next_has_room(monkeypatch: pytest.MonkeyPatch) -> None:
    own = Rasterizer(launcher_on(SOURCE))
    field, view = gaussians(200, seed=1), camera()
    raw = Parameters.of_field(field)
    whole = own.list_tiles(raw, view, 0, None)
    needed = int(whole.ranges[-1])
    with monkeypatch.context() as patch:
        patch.setattr(own.room, "take", lambda gaussians, tiles: needed - 1)
        poor = own.list_tiles(raw, view, 0, None, wait=False)
    image, _ = own.blend(poor, True)
    assert image[3].abs().max() == 0 and poor.tile_counts.abs().max() == 0
    rich = own.list_tiles(raw, view, 0, None, wait=False)
    assert own.room.lost == 1 and len(rich.gid) >= needed
    assert torch.equal(own.blend(rich, True)[0], own.blend(whole, True)[0])


def test_lost_rendering_has_no_gradients_and_no_statistics(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rasterizer_on(SOURCE).room, "take", lambda gaussians, tiles: 3)
    field, stats = leaves(gaussians(50)), RenderStats.zeros(50)
    seen = render(field, camera(), sh_degree=0, backend=SOURCE, stats=stats, wait=False)
    (seen.color.sum() + seen.alpha.sum()).backward()
    assert not seen.visible.any() and stats.count.sum() == 0
    assert all(getattr(field, name).grad.abs().max() == 0 for name in ("positions", "sh"))


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


def test_room_is_not_known_for_a_new_size_of_frame() -> None:
    room = Room()
    assert room.take(100, 9) == 0
    room.learn(100_000, 100, 9)
    assert room.take(100, 9) >= 200_000 and room.take(100, 16) == 0
    room.learn_later(lambda: None, 5, 100, 9)  # not arrived
    assert room.take(200, 9) >= 400_000 and room.lost == 0


def test_rendering_that_does_not_wait_is_the_same() -> None:
    field, view = gaussians(120, seed=4), camera()
    first = assert_agrees(field, view, SOURCE)
    again = render(field, view, sh_degree=3, backend=SOURCE, wait=False)
    assert torch.equal(again.color, first.rendering.color.detach())


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
