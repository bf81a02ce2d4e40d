# SPDX-License-Identifier: GPL-3.0-or-later
"""Room for tile lists that nobody waits for: what it goes by, and what is drawn when it was too small."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest
import torch
from rendered import assert_agrees, camera, gaussians, leaves

from mgf_engine.raster.api import RenderStats, render
from mgf_engine.raster.cpu import Parameters
from mgf_engine.raster.cuda import launcher_on, rasterizer_on
from mgf_engine.raster.cuda.blending import Rasterizer
from mgf_engine.raster.cuda.tile_list_capacity import TileListCapacity

SOURCE = "cuda-source-on-cpu"
TILES = 9


def at_once(needed: int) -> Callable[[], list[int]]:
    return lambda: [needed, needed]


def rendered(capacity: TileListCapacity, needed: int, gaussians: int = 100) -> int:
    """The capacity that a rendering gets; what it needed is told later, or at once where it had to wait."""
    taken = capacity.take(gaussians, TILES)
    if taken:
        capacity.learn_later(at_once(needed), taken, gaussians, TILES)
    else:
        capacity.learn(needed, gaussians, TILES)
    return taken


def test_capacity_is_not_known_for_a_new_size_of_frame() -> None:
    capacity = TileListCapacity()
    assert capacity.take(100, 9) == 0
    capacity.learn(100_000, 100, 9)
    assert capacity.take(100, 9) >= 200_000 and capacity.take(100, 16) == 0
    assert capacity.take(200, 9) >= 400_000 and capacity.lost == 0


def test_only_answers_of_the_rendering_before_the_last_are_asked_for() -> None:
    """Newer ones are never looked at, even if they have arrived: else capacities would depend on the GPU's pace."""
    capacity, asked = TileListCapacity(), []

    def answer(number: int) -> Callable[[], list[int]]:
        def tell() -> list[int]:
            asked.append(number)
            return [1000, 1000]

        return tell

    capacity.learn(1000, 100, TILES)
    for number in range(6):
        taken = capacity.take(100, TILES)
        assert max(asked, default=-1) == max(number - 2, -1), "waits for a rendering that it should not wait for"
        capacity.learn_later(answer(number), taken, 100, TILES)
    assert sorted(set(asked)) == [0, 1, 2, 3]


def test_a_rendering_that_lacks_capacity_is_counted_once_and_the_next_but_one_has_more() -> None:
    capacity = TileListCapacity()
    capacities = [rendered(capacity, needed) for needed in (100_000, 900_000, 900_000, 900_000, 900_000)]
    assert (
        capacities[0] == 0
        and 200_000 <= capacities[1] == capacities[2] < 250_000
        and capacities[3] == capacities[4] > 1_800_000
    )
    assert capacity.lost == 2 and capacity.lost == 2


def test_capacity_shrinks_when_less_is_needed_but_not_within_a_round_of_photos() -> None:
    capacity = TileListCapacity()
    rendered(capacity, 2_000_000)
    for _ in range(600):
        taken = rendered(capacity, 50_000)
    assert taken >= 2_000_000, "the photo that needs most comes again"
    for _ in range(10_000):
        taken = rendered(capacity, 50_000)
    assert 50_000 < taken < 150_000 and capacity.lost == 0


@pytest.mark.parametrize("stop", [1, 2, 3, 7])
def test_a_run_that_goes_on_from_its_state_takes_the_same_capacity(stop: int) -> None:
    needs = [40_000, 20_000, 90_000, 200_000, 30_000, 500_000, 10_000, 70_000, 600_000, 2_000_000, 5, 7]
    whole, first = TileListCapacity(), TileListCapacity()
    expected = [rendered(whole, needed) for needed in needs]
    found = [rendered(first, needed) for needed in needs[:stop]]
    second = TileListCapacity()
    second.learn(10**8, 1, TILES)  # another run of the process
    second.restore(json.loads(json.dumps(first.state())))
    found += [rendered(second, needed) for needed in needs[stop:]]
    assert found == expected and second.lost == whole.lost > 0
    second.restore()
    assert second.take(100, TILES) == 0 and second.lost == 0


def test_rendering_without_capacity_draws_nothing_and_the_next_has_capacity(monkeypatch: pytest.MonkeyPatch) -> None:
    own = Rasterizer(launcher_on(SOURCE))
    field, view = gaussians(200, seed=1), camera()
    raw = Parameters.of_field(field)
    whole = own.list_tiles(raw, view, 0, None)
    needed = int(whole.ranges[-1])
    assert own.capacity.take(200, 9) == 0, "what waits changes nothing for what does not"
    with monkeypatch.context() as patch:
        patch.setattr(own.capacity, "take", lambda gaussians, tiles: needed - 1)
        poor = own.list_tiles(raw, view, 0, None, wait=False)
    image, _ = own.blend(poor, True)
    assert image[3].abs().max() == 0 and poor.tile_counts.abs().max() == 0
    assert own.capacity.lost == 1
    for _ in range(2):  # the first waits for itself
        rich = own.list_tiles(raw, view, 0, None, wait=False)
        assert len(rich.gid) >= needed
        assert torch.equal(own.blend(rich, True)[0], own.blend(whole, True)[0])
    assert own.capacity.lost == 1 and len(rich.gid) > needed


def test_lost_rendering_has_no_gradients_and_no_statistics(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rasterizer_on(SOURCE).capacity, "take", lambda gaussians, tiles: 3)
    field, stats = leaves(gaussians(50)), RenderStats.zeros(50)
    seen = render(field, camera(), sh_degree=0, backend=SOURCE, stats=stats, wait=False)
    (seen.color.sum() + seen.alpha.sum()).backward()
    assert not seen.visible.any() and stats.count.sum() == 0
    assert all(getattr(field, name).grad.abs().max() == 0 for name in ("positions", "sh"))


def test_rendering_that_does_not_wait_is_the_same() -> None:
    field, view = gaussians(120, seed=4), camera()
    first = assert_agrees(field, view, SOURCE)
    for _ in range(2):
        again = render(field, view, sh_degree=3, backend=SOURCE, wait=False)
        assert torch.equal(again.color, first.rendering.color.detach())


@pytest.mark.parametrize(
    "state",
    [
        [1], {"per_gaussian": [], "asked": []}, {"per_gaussian": [[4, float("nan")]], "asked": [], "lost": 0},
        {"per_gaussian": [[4, "many"]], "asked": [], "lost": 0}, {"per_gaussian": [], "asked": [[1, 2]], "lost": 0},
    ],
)  # fmt: skip
def test_what_is_no_state_changes_nothing(state: Any) -> None:
    capacity = TileListCapacity()
    capacity.learn(900, 30, 4)
    before = capacity.state()
    with pytest.raises((ValueError, TypeError, KeyError, OverflowError)):
        capacity.restore(state)
    assert capacity.state() == before
