# SPDX-License-Identifier: GPL-3.0-or-later
"""Frayed eaves become one line; steps and slopes stay."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.drawings.straighten import Stroke, straighten
from mgf_engine.drawings.trace import trace

PIXEL = 1.0
WIDTH = 240


def border(height: np.ndarray) -> np.ndarray:
    """The border between two regions, [n, 2]: the lower one is so high in each column."""
    label = np.where(np.arange(100)[:, None] >= height[None], 2, 1).astype(np.int32)
    return max((chain.corners for chain in trace(label) if (chain.low, chain.high) == (1, 2)), key=len)


def drawn(height: np.ndarray, frayed: bool = True, turned: bool = False) -> Stroke:
    corners = border(np.rint(height).astype(int))
    return straighten(corners[:, ::-1].copy() if turned else corners, (0, 1), PIXEL, frayed=frayed)


def eaves(seed: int = 0) -> np.ndarray:
    """Level at 50, wandering by three pixels over some length, with two spurs."""
    rng = np.random.default_rng(seed)
    height = 50 + np.interp(np.arange(WIDTH), np.arange(0, WIDTH + 1, 8), rng.uniform(-3, 3, WIDTH // 8 + 1))
    height[100:108] += 15
    height[170:176] -= 12
    return height


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_frayed_eaves_are_one_level_line(seed: int, turned: bool) -> None:
    before, stroke = drawn(eaves(seed), frayed=False, turned=turned), drawn(eaves(seed), turned=turned)
    assert len(before.segments) > 6
    assert len(stroke.segments) == 1
    across = stroke.points[:, 0 if turned else 1]
    assert np.ptp(across) == 0 and across[0] == pytest.approx(50, abs=1.5)
    assert np.ptp(stroke.points[:, 1 if turned else 0]) == pytest.approx(WIDTH, abs=1)


@pytest.mark.parametrize(
    "height",
    [
        np.where(np.arange(WIDTH) < 140, 50, 56),
        np.where((np.arange(WIDTH) > 100) & (np.arange(WIDTH) < 140), 40, 50),
        30 + 0.2 * np.arange(WIDTH),
        50 + 20 * np.abs(np.arange(WIDTH) / WIDTH - 0.5),
    ],
    ids=["step", "dormer", "slope", "gable"],
)
def test_what_is_not_frayed_stays(height: np.ndarray) -> None:
    plain, stroke = drawn(height, frayed=False), drawn(height)
    np.testing.assert_array_equal(plain.points, stroke.points)
