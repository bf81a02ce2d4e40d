# SPDX-License-Identifier: GPL-3.0-or-later
"""Advice on buildings that are small in the working photos."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.synthetic.plain_house import PlainHouse, make_plain_house
from mgf_engine.masks.validation.building_size import small_building_warning


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> PlainHouse:
    return make_plain_house(tmp_path_factory.mktemp("plain") / "scene")


def advice(plain: PlainHouse, length: int, reduced: float, used: bool = True) -> str | None:
    """Of photos whose best one shows a building of this length, reduced so many times."""
    side = max(plain.scene.views[0].width, plain.scene.views[0].height)
    views, labels = [], []
    for k, view in enumerate(plain.scene.views):
        views.append(replace(view, original_width=round(side * reduced), original_height=round(side * reduced)))
        label = np.zeros((view.height, view.width), np.uint8)
        label[5:9, 5 : 5 + length // (1 + k)] = 1
        labels.append(label)
    masks = replace(plain.masks, labels=tuple(labels), used=np.full(len(views), used))
    return small_building_warning(replace(plain.scene, views=tuple(views)), masks)


def test_a_small_building_in_large_photos_gets_an_advice(plain: PlainHouse) -> None:
    side = max(plain.scene.views[0].width, plain.scene.views[0].height)
    text = advice(plain, side // 4, 20.0)
    assert text is not None and f"at most {side // 4} pixels long" in text and f"the photos have {20 * side}" in text
    assert "--resolution 1600 " in text  # 400 pixels for a quarter of the photo


def test_no_more_pixels_are_advised_than_there_are(plain: PlainHouse) -> None:
    side = max(plain.scene.views[0].width, plain.scene.views[0].height)
    assert f"--resolution {2 * side} " in (advice(plain, side // 4, 2.0) or "")
    assert advice(plain, side // 4, 1.2) is None


def test_a_building_that_fills_the_photos_or_has_no_mask_gets_none(plain: PlainHouse) -> None:
    side = max(plain.scene.views[0].width, plain.scene.views[0].height)
    assert advice(plain, side // 2, 20.0) is None
    assert advice(plain, side // 4, 20.0, used=False) is None
