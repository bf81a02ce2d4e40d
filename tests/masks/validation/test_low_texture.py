# SPDX-License-Identifier: GPL-3.0-or-later
"""Walls without texture are spoken of; painted ones are not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.small_scene import make_scene, view

from benchmarks.perturb import perturb
from benchmarks.synthetic.colmap_scene import Messages
from benchmarks.synthetic.house_scene import house_scene
from mgf_engine.masks.build import build_masks
from mgf_engine.masks.validation.low_texture import LowTextureOptions, low_texture_share
from mgf_engine.model.masks import MaskSet
from mgf_engine.model.scene import Scene
from mgf_engine.options.config import make_config
from mgf_engine.scene.load import load_scene


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return house_scene(tmp_path_factory)


@pytest.mark.parametrize(("level", "plain"), [(0.0, False), (0.5, False), (1.0, True)])
def test_plain_walls_are_spoken_of(source: Path, tmp_path: Path, level: float, plain: bool) -> None:
    folder = perturb(source, tmp_path / "copy", "walls", level)
    messages, config = Messages(), make_config({})
    scene = load_scene(folder, tmp_path / "job/scene", config, messages.reporter)
    masks = build_masks(scene, None, folder / "masks", tmp_path / "job/masks", config, messages.reporter)
    share = low_texture_share(scene, masks)
    assert (share > LowTextureOptions().warn_above) == plain, share
    assert any("of the building has neither texture" in text for text in messages.warnings) == plain


@pytest.mark.parametrize("textured", [False, True])
@pytest.mark.parametrize("points", [[], [(10.5, 20.5)]])
def test_plain_is_what_has_neither_texture_nor_a_point_near_it(
    textured: bool, points: list[tuple[float, float]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A grey photo of 40 x 40 px or a chequerboard; a point counts one pixel around it."""
    photo = np.full((40, 40, 3), 128, np.uint8)
    photo[np.indices((40, 40)).sum(0) % 2 == 0] += 50 * textured
    monkeypatch.setattr(Scene, "photo", lambda scene, index: photo)
    tracks = [[(0, *at)] for at in points]
    scene = make_scene([view("a.jpg", 0, width=40, height=40)], np.zeros((len(points), 3)), tracks)
    on_building, one = np.ones(len(points), bool), np.ones(1, np.float32)
    masks = MaskSet((np.ones((40, 40), np.uint8),), np.ones(1, bool), one, on_building)
    share = low_texture_share(scene, masks, LowTextureOptions(near_point=0.02))
    assert share == pytest.approx(0.0 if textured else 1.0 - 9 * len(points) / 1600)
    assert low_texture_share(scene, replace(masks, used=np.zeros(1, bool))) == 0.0
