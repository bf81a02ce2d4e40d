# SPDX-License-Identifier: GPL-3.0-or-later
"""When things happen during training, and how the time left is told."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.field.schedule import (
    LearningRates,
    ScheduleOptions,
    covers_all_views,
    geometry_at,
    lr_scale_of,
    rates_at,
    reduction_at,
    sh_degree_at,
    view_order,
    work_at,
)
from mgf_engine.options.config import make_config


@pytest.mark.parametrize(("side", "levels"), [(750, [4, 2, 1]), (400, [2, 1]), (200, [1])])
def test_pictures_grow_and_never_start_too_small(side: int, levels: list[int]) -> None:
    seen = [reduction_at(share, side) for share in np.linspace(0, 1, 101)]
    assert list(dict.fromkeys(seen)) == levels


@pytest.mark.parametrize("side", [200, 400, 750])
def test_work_goes_from_nothing_to_all_and_slower_while_pictures_are_small(side: int) -> None:
    shares = np.linspace(0, 1, 101)
    work = np.array([work_at(share, side) for share in shares])
    assert work[0] == 0 and work[-1] == pytest.approx(1) and (np.diff(work) > 0).all()
    assert (work <= shares + 1e-9).all()
    if side == 200:
        assert work == pytest.approx(shares)
    else:
        assert work[40] < 0.35


def test_work_is_even_at_one_resolution() -> None:
    options = make_config({"coarse_to_fine": False}).algorithm(ScheduleOptions)
    assert work_at(0.3, 750, options) == pytest.approx(0.3)


def test_rates_only_fall() -> None:
    for name, first in rates_at(0.0).items():
        values = [rates_at(share)[name] for share in np.linspace(0, 1, 21)]
        assert values[0] == first and (np.diff(values) <= 0).all() and values[-1] > 0


def test_rates_of_positions_may_be_in_units_of_the_extent() -> None:
    rates = LearningRates(positions=1.6e-4, positions_final=1.6e-6, by_extent=True).for_extent(5.0)
    assert [rates_at(share, 1.0, rates)["positions"] for share in (0.0, 1.0)] == pytest.approx([8e-4, 8e-6])
    assert LearningRates().for_extent(5.0) == LearningRates()


def test_a_run_cut_short_takes_larger_steps() -> None:
    assert lr_scale_of(2000, 2000) == lr_scale_of(9000, 2000) == 1.0
    assert lr_scale_of(1000, 2000) == pytest.approx(2**0.5)
    assert lr_scale_of(1, 2000) == lr_scale_of(2, 2000) > lr_scale_of(1000, 2000)  # but not without limit
    assert rates_at(0.7, 1.5) == pytest.approx({name: 1.5 * rate for name, rate in rates_at(0.7).items()})


def test_geometry_terms_have_their_weight_on_average() -> None:
    options = ScheduleOptions(geometry_from=0.4)
    assert not any(geometry_at(i, 0.39, options) for i in range(30))
    factors = [geometry_at(i, 0.4, options) for i in range(30)]
    assert np.mean(factors) == pytest.approx(1.0) and 0.0 in factors


def test_harmonics_come_one_degree_after_the_other() -> None:
    assert [sh_degree_at(share, ScheduleOptions(sh_degree=2)) for share in (0.0, 0.09, 0.1, 0.25, 1.0)] == [
        0,
        0,
        1,
        2,
        2,
    ]
    slow = make_config({"sh_degree": 3, "schedule.sh_degree_steps": 2}).algorithm(ScheduleOptions)
    assert [sh_degree_at(share, slow) for share in (0.0, 0.5, 1.0)] == [0, 1, 2]


@pytest.mark.parametrize(("first", "last", "complete"), [(0, 5, False), (0, 6, True), (2, 8, False), (3, 14, True)])
def test_all_views_have_had_a_turn(first: int, last: int, complete: bool) -> None:
    assert covers_all_views(first, last, 6, 4) == complete


def test_two_epochs_may_show_the_same_views() -> None:
    orders = [view_order(6, epoch, 4) for epoch in range(2)]
    assert set(orders[0][2:] + orders[1][:2]) != set(range(6))  # so 2..8 is not complete, though six had a turn
