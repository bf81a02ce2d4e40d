# SPDX-License-Identifier: GPL-3.0-or-later
"""Roots are few and far apart; held-out views are spread evenly and are not roots."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.scene.roots import choose_held_out, choose_roots, sample_views


def circle(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    direction = np.stack([-np.cos(angle), -np.sin(angle), 0 * angle], 1)
    return -5 * direction, direction, np.full(count, 10)


@pytest.mark.parametrize(("views", "roots"), [(1, 1), (2, 2), (3, 3), (10, 3), (15, 3), (16, 4), (20, 4), (146, 30)])
def test_count(views: int, roots: int) -> None:
    chosen = choose_roots(*circle(views))
    assert len(chosen) == len(set(chosen)) == roots
    assert list(chosen) == sorted(chosen)


def test_roots_on_a_circle_are_spread() -> None:
    chosen = np.array(choose_roots(*circle(20)))
    assert np.diff(chosen, append=chosen[0] + 20).tolist() == [5, 5, 5, 5]


def test_fewer_views_are_among_the_first_of_more() -> None:
    """So the photos the user is asked to click on are always among those that are used."""
    few, many = (sample_views(*circle(40), count) for count in (8, 25))
    assert many[:8] == few and len(set(many)) == 25


def test_wanted_views_come_first_and_the_others_keep_away_from_them() -> None:
    chosen = sample_views(*circle(12), 4, wanted={1, 4})
    assert chosen[:2] == [1, 4] and set(chosen[2:]) <= {7, 8, 9, 10}
    assert sample_views(*circle(12), 2, wanted={5, 6, 7}) == [5, 6, 7]
    assert sorted(sample_views(*circle(5), 99, wanted={3})) == [0, 1, 2, 3, 4]


def test_cameras_in_one_spot_are_spread_by_direction() -> None:
    centres, directions, seen = circle(20)
    chosen = choose_roots(np.zeros_like(centres), directions, seen)
    assert np.diff(chosen, append=chosen[0] + 20).tolist() == [5, 5, 5, 5]


def test_equal_views_and_the_best_seen_one() -> None:
    centres, directions, seen = circle(10)
    seen[7] = 99
    assert 7 in choose_roots(centres, directions, seen)
    assert len(set(choose_roots(np.zeros((7, 3)), np.ones((7, 3)), np.zeros(7, np.int64)))) == 3


@pytest.mark.parametrize("views", [4, 11, 25, 64, 147])
@pytest.mark.parametrize("every", [2, 8, 50])
def test_held_out(views: int, every: int) -> None:
    roots = choose_roots(*circle(views))
    held_out = choose_held_out(views, roots, every)
    assert len(set(held_out)) == len(held_out) == min(-(-views // every), views - 3)
    spare = views - len(roots)
    assert len(set(held_out) & set(roots)) == max(0, len(held_out) - spare)
    if len(held_out) > 2 and len(held_out) <= spare / 2:
        gaps = np.diff(held_out)
        assert gaps.max() <= 2.5 * views / len(held_out)


def test_held_out_of_very_many_views() -> None:
    """Minutes where each choice looks at all of them."""
    assert choose_held_out(200_000, (), 8) == tuple(range(3, 200_000, 8))


def test_nothing_is_held_out_when_asked_or_when_too_few() -> None:
    assert choose_held_out(30, (0, 1), 0) == ()
    assert choose_held_out(3, (0, 1, 2), 8) == ()
