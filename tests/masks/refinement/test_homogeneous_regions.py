# SPDX-License-Identifier: GPL-3.0-or-later
"""Homogeneous regions are building as a whole or not at all, up to their edges and no further."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.masks.refinement.homogeneous_regions import (
    HomogeneousRegionOptions,
    find_clicked_regions,
    find_missing_pixels,
)
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


LARGE = HomogeneousRegionOptions(largest=0.4)  # the wall fills a third of the photo
ON_WALL, ON_LAWN = np.array([[60.0, 100.0]]), np.array([[20.0, 140.0]])


def test_a_click_on_a_plain_wall_means_all_of_it_up_to_its_edges() -> None:
    lab, true = photo()
    found = find_clicked_regions(lab, np.zeros_like(true), ON_WALL, ON_LAWN, LARGE)
    assert found[32:118, 42:128].all()
    assert not (found & ~true).any()


def test_a_region_that_is_mostly_building_is_filled_without_a_click() -> None:
    lab, true = photo()
    assert find_clicked_regions(lab, bitten(true) > 0, NONE, NONE, LARGE)[112:118, 62:98].all()


def test_regions_that_clicks_leave_open_stay_as_they_are() -> None:
    lab, true = photo()
    nothing = np.zeros_like(true)
    assert not find_clicked_regions(lab, nothing, NONE, NONE, LARGE).any()
    assert not find_clicked_regions(lab, nothing, ON_WALL, ON_WALL + 10, LARGE).any(), "on it and beside the building"
    assert not find_clicked_regions(lab, nothing, ON_LAWN, NONE, LARGE).any(), "the lawn reaches the top"
    assert not find_clicked_regions(lab, nothing, ON_WALL, NONE).any(), "more than a quarter of the photo"
    lab[:30, 40:130] = WALL
    assert not find_clicked_regions(lab, nothing, ON_WALL, NONE, LARGE).any(), "as sky does, this reaches the top"
