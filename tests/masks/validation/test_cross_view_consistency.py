# SPDX-License-Identifier: GPL-3.0-or-later
"""Given masks that the others contradict are found; without a majority all are refused."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from support.small_scene import make_scene, view

from mgf_engine.errors import BadInput
from mgf_engine.masks.validation.cross_view_consistency import find_contradicted_masks
from mgf_engine.model.scene import Scene

VIEWS, SIDE = 10, 40


@pytest.fixture
def scene() -> Scene:
    """Ten views of 60 points spread over the frame; all see all of them at the same place."""
    uv = np.random.default_rng(2).uniform(2, SIDE - 2, (60, 2))
    views = [view(f"{i}.jpg", i, width=SIDE, height=SIDE) for i in range(VIEWS)]
    tracks = [[(v, float(u[0]), float(u[1])) for v in range(VIEWS)] for u in uv]
    return make_scene(views, np.zeros((len(uv), 3)), tracks)


def masks(wrong: int) -> list[np.ndarray]:
    """Half of the frame is building; the wrong masks say the other half."""
    good = np.zeros((SIDE, SIDE), np.uint8)
    good[:, : SIDE // 2] = 1
    return [1 - good if i < wrong else good.copy() for i in range(VIEWS)]


ALL = np.ones(VIEWS, bool)


def test_masks_that_agree_are_kept(scene: Scene) -> None:
    assert find_contradicted_masks(scene, masks(0), ALL, 1) == {}


@pytest.mark.parametrize("wrong", [1, 2, 4])
def test_wrong_masks_are_found_and_only_they(scene: Scene, wrong: int) -> None:
    found = find_contradicted_masks(scene, masks(wrong), ALL, 0)
    assert set(found) == set(range(wrong))
    assert all(score < 0 for score in found.values())


def test_a_right_mask_that_shares_points_with_wrong_ones_is_kept() -> None:
    """Half of what the last photo sees only the two wrong ones see, too: until they are out, it looks wrong itself."""
    uv = np.random.default_rng(2).uniform(2, SIDE - 2, (120, 2))
    views = [view(f"{i}.jpg", i, width=SIDE, height=SIDE) for i in range(VIEWS)]
    seen_by = [range(VIEWS)] * 60 + [(0, 1, VIEWS - 1)] * 60
    tracks = [[(v, float(u), float(w)) for v in who] for (u, w), who in zip(uv, seen_by, strict=True)]
    found = find_contradicted_masks(make_scene(views, np.zeros((len(uv), 3)), tracks), masks(2), ALL, 0)
    assert set(found) == {0, 1}


def test_no_majority_is_refused(scene: Scene) -> None:
    with pytest.raises(BadInput, match="contradict each other"):
        find_contradicted_masks(scene, masks(5), ALL, 0)


def test_smaller_and_larger_masks_are_no_contradiction(scene: Scene) -> None:
    labels = masks(0)
    labels[0] = cv2.erode(labels[0], np.ones((9, 9), np.uint8))
    labels[1] = cv2.dilate(labels[1], np.ones((9, 9), np.uint8))
    assert find_contradicted_masks(scene, labels, ALL, 1) == {}


def test_photos_without_a_mask_and_unknown_pixels_say_nothing(scene: Scene) -> None:
    labels = masks(0)
    labels[0] = np.zeros((SIDE, SIDE), np.uint8)
    labels[1][:, : SIDE // 2] = 255
    used = ALL.copy()
    used[0] = False
    assert find_contradicted_masks(scene, labels, used, 0) == {}
