# SPDX-License-Identifier: GPL-3.0-or-later
"""Pieces of a mask that no click, no point and no extent speaks for."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.masks.refinement.stray_pieces import find_stray_pieces

HOUSE, SHED, CAR = np.s_[10:40, 10:40], np.s_[10:20, 60:70], np.s_[45:55, 60:80]


@pytest.fixture
def mask() -> np.ndarray:
    result = np.zeros((60, 100), bool)
    for piece in (HOUSE, SHED, CAR):
        result[piece] = True
    return result


def core(share: float) -> np.ndarray:
    """All of the house, and this share of the shed."""
    result = np.zeros((60, 100), bool)
    result[HOUSE] = True
    result[10 : 10 + round(10 * share), 60:70] = True
    return result


def test_pieces_beside_the_building_are_stray(mask: np.ndarray) -> None:
    stray = find_stray_pieces(mask, core(0.5), np.array([[20.5, 20.5]]), 0.3)
    expected = np.zeros_like(mask)
    expected[CAR] = True
    assert (stray == expected).all()


@pytest.mark.parametrize(("share", "kept"), [(0.2, False), (0.4, True)])
def test_the_extent_must_cover_a_share_of_a_piece(mask: np.ndarray, share: float, kept: bool) -> None:
    assert find_stray_pieces(mask, core(share), np.array([[20.5, 20.5]]), 0.3)[SHED].any() != kept


def test_a_click_or_a_point_keeps_a_piece(mask: np.ndarray) -> None:
    assert not find_stray_pieces(mask, core(1.0), np.array([[20.5, 20.5], [70.5, 50.5]]), 0.3).any()


def test_without_anything_known_nothing_is_stray(mask: np.ndarray) -> None:
    assert not find_stray_pieces(mask, core(0.0), np.zeros((0, 2)), 0.3).any()
    assert not find_stray_pieces(mask, core(0.0), np.array([[90.5, 30.5]]), 0.3).any()  # known pixels off the mask
