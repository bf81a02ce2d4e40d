# SPDX-License-Identifier: GPL-3.0-or-later
"""Why a mask is left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.small_scene import make_scene, view

from mgf_engine.masks.validation.mask_flags import (
    NO_BUILDING,
    FlagOptions,
    describe_flags,
    flag_reason,
    measure_consistency,
)
from mgf_engine.model.masks import BUILDING, MaskSet

OPTIONS = FlagOptions()
BELOW = OPTIONS.flag_below
WHOLE = np.full((10, 10), BUILDING, np.uint8)


@pytest.mark.parametrize(
    ("labels", "score", "disagreement", "reason"),
    [
        (WHOLE, 1.0, 0.0, ""),
        (WHOLE, BELOW + 0.01, 0.99 - BELOW, ""),
        (WHOLE, BELOW - 0.01, 0.0, "mask and points agree only"),
        (WHOLE, 1.0, 1.01 - BELOW, "other photos contradict"),
        (np.zeros((10, 10), np.uint8), 1.0, 0.0, "hardly any building"),
    ],
)
def test_a_mask_is_left_out_for_one_reason(labels: np.ndarray, score: float, disagreement: float, reason: str) -> None:
    found = flag_reason(labels, score, disagreement, OPTIONS)
    assert found.startswith(reason) and bool(found) == bool(reason)


def test_photos_agree_on_a_point_where_at_most_a_tenth_of_them_differs() -> None:
    """Points seen by 11 photos (one differs), by 5 (one differs), by 3 and by 2 (which are too few to agree)."""
    tracks = [[(v, 5.5, 5.5) for v in range(11)], [(v, 5.5, 5.5) for v in range(5)], [(v, 5.5, 5.5) for v in (1, 2, 3)],
              [(0, 5.5, 5.5), (1, 5.5, 5.5)]]  # fmt: skip
    scene = make_scene([view(f"{v}.jpg", 0) for v in range(11)], np.zeros((4, 3)), tracks)
    labels = [np.full((10, 20), 0 if v == 0 else BUILDING, np.uint8) for v in range(11)]
    masks = MaskSet(tuple(labels), np.ones(11, bool), np.ones(11, np.float32), np.ones(4, bool))
    assert measure_consistency(scene, masks, 0) == pytest.approx(2 / 3)
    without = replace(masks, used=np.arange(11) > 0)
    assert measure_consistency(scene, without, 0) == 1.0
    assert measure_consistency(scene, replace(masks, used=np.zeros(11, bool)), 0) == 1.0


def test_photos_beside_the_building_are_no_weak_masks() -> None:
    """A flight over a village shows a house in ten photos of 34; the others were all called weak."""
    names = [f"{k}.jpg" for k in range(9)]
    beside, weak = describe_flags(names, [NO_BUILDING] * 6 + ["mask and points agree only to 40%", "", ""])
    assert beside.startswith("6 of 9 photos show hardly any of the building and are left out (0.jpg, 1.jpg, 2.jpg, 3")
    assert "4.jpg, ...)" in beside and "5.jpg" not in beside
    assert weak == "1 of 9 masks are weak and left out (6.jpg); look at the contact sheet."
    assert describe_flags(names, [""] * 9) == []
