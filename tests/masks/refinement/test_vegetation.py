# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

import cv2
import numpy as np

from mgf_engine.masks.refinement.vegetation import find_foreground_leaves
from mgf_engine.model.masks import BACKGROUND, BUILDING, IGNORE


def scene() -> tuple[np.ndarray, np.ndarray]:
    """A wall with a tree before its middle, another tree beside it."""
    labels = np.full((100, 200), BACKGROUND, np.uint8)
    labels[30:90, 40:160] = BUILDING
    leafy = np.zeros((100, 200))
    labels[30:90, 90:110] = BACKGROUND
    leafy[20:90, 90:110] = 1
    leafy[20:90, 170:195] = 1
    return labels, leafy


def test_a_tree_before_the_building_is_found_and_one_beside_it_is_not():
    found = find_foreground_leaves(*scene())
    assert found[30:90, 90:110].all()
    assert found.sum() == 60 * 20


def test_gaps_between_leaves_belong_to_them():
    labels, leafy = scene()
    leafy[50:52, 90:110] = 0
    assert find_foreground_leaves(labels, leafy)[30:90, 90:110].all()


def test_what_is_no_leaves_stays_background():
    labels, _ = scene()
    assert not find_foreground_leaves(labels, np.zeros(labels.shape)).any()


def test_nothing_without_a_building():
    assert not find_foreground_leaves(np.zeros((50, 60), np.uint8), np.ones((50, 60))).any()


def test_a_building_that_is_unknown_at_one_end_reaches_that_far():
    labels, leafy = scene()
    labels[30:90, 110:160] = IGNORE
    assert find_foreground_leaves(labels, leafy)[30:90, 90:110].all()


def test_the_hull_of_a_ragged_building_is_that_of_all_its_pixels():
    rng = np.random.default_rng(1)
    labels = np.where(rng.random((60, 90)) > 0.995, BUILDING, BACKGROUND).astype(np.uint8)
    corners = cv2.findNonZero(labels)
    hull = np.zeros(labels.shape, np.uint8)
    cv2.fillConvexPoly(hull, cv2.convexHull(corners), 1)
    found = find_foreground_leaves(labels, np.ones(labels.shape))
    assert (found == ((hull > 0) & (labels == BACKGROUND))).all()
