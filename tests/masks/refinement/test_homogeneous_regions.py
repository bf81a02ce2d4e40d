# SPDX-License-Identifier: GPL-3.0-or-later
"""Homogeneous regions are building as a whole or not at all, up to their edges and no further."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.masks.refinement.homogeneous_regions import find_missing_pixels
from mgf_engine.model.masks import IGNORE

WALL, LAWN, PAVING = (90.0, 0.0, 5.0), (50.0, -30.0, 30.0), (75.0, 0.0, 5.0)  # CIELAB
SIZE = 160
NONE = np.zeros((0, 2))


def photo() -> tuple[np.ndarray, np.ndarray]:
    """A white wall on a lawn, with a little noise, and its true mask."""
    true = np.zeros((SIZE, SIZE), bool)
    true[30:120, 40:130] = True
    lab = np.where(true[..., None], WALL, LAWN) + np.random.default_rng(0).normal(size=(SIZE, SIZE, 3)) * 0.3
    return lab.astype(np.float32), true


def bitten(true: np.ndarray, label: int = 0) -> np.ndarray:
    """The true mask with a piece of the wall's foot missing."""
    labels = true.astype(np.uint8)
    labels[112:120, 60:100] = label
    return labels


@pytest.mark.parametrize("label", [0, IGNORE])
def test_a_bite_at_the_foot_of_a_plain_wall_is_filled_up_to_its_edge(label: int) -> None:
    lab, true = photo()
    labels = bitten(true, label)
    found = find_missing_pixels(lab, labels, np.zeros_like(true), NONE)
    assert found[112:118, 62:98].all()
    assert not (found & ~true).any()


def test_a_whole_mask_gains_nothing() -> None:
    lab, true = photo()
    found = find_missing_pixels(lab, true.astype(np.uint8), np.zeros_like(true), NONE)
    assert not found.any()


def test_a_region_that_is_mostly_background_stays() -> None:
    lab, true = photo()
    labels = true.astype(np.uint8)
    labels[60:120] = 0
    assert not find_missing_pixels(lab, labels, np.zeros_like(true), NONE).any()


def test_paving_of_another_brightness_stays_out_where_its_edge_is_blurred() -> None:
    lab, true = photo()
    lab[120:150, 40:130] = PAVING
    ramp = np.linspace(0, 1, 16)[:, None, None]
    lab[112:128, 60:80] = (1 - ramp) * np.array(WALL) + ramp * np.array(PAVING)
    assert not find_missing_pixels(lab, true.astype(np.uint8), np.zeros_like(true), NONE)[130:].any()


def test_sky_and_negative_clicks_are_kept() -> None:
    lab, true = photo()
    labels = bitten(true)
    assert not find_missing_pixels(lab, labels, labels == 0, NONE).any()
    assert not find_missing_pixels(lab, labels, np.zeros_like(true), np.array([[80.0, 115.0]])).any()
    assert find_missing_pixels(lab, labels, np.zeros_like(true), np.array([[5.0, 5.0]])).any()


def test_an_empty_mask_gains_nothing() -> None:
    lab, true = photo()
    assert not find_missing_pixels(lab, np.zeros(true.shape, np.uint8), np.zeros_like(true), NONE).any()
