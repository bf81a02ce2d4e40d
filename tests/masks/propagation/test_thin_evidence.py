# SPDX-License-Identifier: GPL-3.0-or-later
"""A part of another colour belongs to the building although it is clicked once, in one photo."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.synthetic.house import OFFSET, House, build_house, paint
from mgf_engine.masks.build import build_masks
from mgf_engine.messages import Message, Reporter
from mgf_engine.model.masks import MaskSet, building
from mgf_engine.model.scene import Scene
from mgf_engine.options.config import make_config
from mgf_engine.scene.load import load_scene

CONFIG = make_config({"segmenter": "random_walker", "device": "cpu", "second_level": "off"})
END = 0.4  # metres along the house, from where on it has the colour of the paving
#: Metres in the house's frame.
SPOTS = {"wall": (-1.5, -1.5, 1.0), "end": (2.0, 0.3, 1.0), "paving": (-0.5, -2.2, 0.0), "behind": (3.4, 0.2, 0.0)}


def grey_end(points: NDArray[np.float64], faces: NDArray[np.int32], count: int) -> NDArray[np.uint8]:
    """Paint the house, but paving in place of the lawn, and one end of the house in its colour."""
    colours, lawn = paint(points, faces, count), paint(points, np.full_like(faces, count), count)
    grey = (faces >= count) | (points[..., 0] - OFFSET[0] > END)
    colours[grey] = np.clip(lawn[grey] * np.array([1.56, 0.91, 1.83]), 0, 255).astype(np.uint8)
    return colours


def quiet(messages: list[Message] | None = None) -> Reporter:
    reporter = Reporter([].append if messages is None else messages.append)
    reporter.stage("masks")
    return reporter


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> House:
    return build_house(tmp_path_factory.mktemp("house"), painted=grey_end)


@pytest.fixture(scope="module")
def scene(house: House, tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return load_scene(house.folder, tmp_path_factory.mktemp("job") / "scene", make_config(), quiet())


def masks_with(scene: Scene, last: str, folder: Path) -> tuple[MaskSet, list[str]]:
    """Make the masks from three photos of the front and one more click in the photo of the end; with the warnings."""
    views = {view.name: view for view in scene.views}

    def pixel(name: str, spot: str) -> list[float]:
        return views[name].project(scene.to_normalised.apply(OFFSET[None] + SPOTS[spot]))[0][0].tolist()

    prompts: dict[str, Any] = {
        name: {"positive": [pixel(name, "wall")], "negative": [pixel(name, "paving")]}
        for name in ("photo_08.png", "photo_09.png", "photo_10.png")
    }
    prompts["photo_12.png"] = {"positive": [pixel("photo_12.png", spot) for spot in ("wall", last)]}
    (folder / "prompts.json").write_text(json.dumps(prompts))
    messages: list[Message] = []
    masks = build_masks(scene, folder / "prompts.json", None, folder / "masks", CONFIG, quiet(messages))
    return masks, [m["text"] for m in messages if m["type"] == "warning"]


def test_an_end_in_the_colour_of_the_paving_is_building_by_one_click(scene: Scene, house: House, tmp_path: Path):
    """Without the click the end stays out: the mean IoU is 0.55, and photos from its side have below 0.4."""
    masks, warnings = masks_with(scene, "end", tmp_path)
    for view, labels in zip(scene.views, masks.labels, strict=True):
        mine, true = building(labels), house.masks[view.name]
        assert (mine & true).sum() > 0.85 * (mine | true).sum()
    assert masks.used.all() and not warnings


def test_a_click_on_the_paving_is_an_outlier(scene: Scene, tmp_path: Path):
    _, warnings = masks_with(scene, "behind", tmp_path)
    assert any("photo_12.png" in text and "are ignored" in text for text in warnings)
