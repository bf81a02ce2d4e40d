# SPDX-License-Identifier: GPL-3.0-or-later
"""Walls without texture are spoken of; painted ones are not."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.perturb import perturb
from benchmarks.synthetic.colmap_scene import Messages
from benchmarks.synthetic.house_scene import house_scene
from mgf_engine.masks.build import build_masks
from mgf_engine.masks.validation.low_texture import LowTextureOptions, low_texture_share
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
