# SPDX-License-Identifier: GPL-3.0-or-later
"""What was clicked in several photos is no slip, whatever the others' clicks say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.synthetic.house import OFFSET, House
from mgf_engine.masks.build import build_masks
from mgf_engine.masks.prompts import Clicks, Prompts
from mgf_engine.masks.propagation.prompt_agreement import drop_confirmed
from mgf_engine.masks.propagation.prompt_outliers import OutlierPrompt
from mgf_engine.messages import Message, Reporter
from mgf_engine.model.scene import Scene
from mgf_engine.options.config import make_config

CONFIG = make_config({"segmenter": "random_walker", "device": "cpu", "second_level": "off"})

SPOT = np.array([3.2, 0.0, 0.0])  # on the lawn before the house, metres
CLICKED = ("photo_03.png", "photo_12.png")  # that show it


def seen_at(scene: Scene, name: str, spot: np.ndarray) -> list[float]:
    view = next(v for v in scene.views if v.name == name)
    return view.project(scene.to_normalised.apply(OFFSET[None] + spot))[0][0].tolist()


def warnings_with(scene: Scene, house: House, photos: tuple[str, ...], folder: Path) -> list[str]:
    """What is said when the spot is clicked as the building in some photos."""
    clicks: dict[str, Any] = json.loads(house.prompts.read_text())
    for name in photos:
        clicks[name]["positive"].append(seen_at(scene, name, SPOT))
    folder.mkdir()
    path = folder / "prompts.json"
    path.write_text(json.dumps(clicks))
    messages: list[Message] = []
    reporter = Reporter(messages.append)
    reporter.stage("masks")
    build_masks(scene, path, None, folder / "masks", CONFIG, reporter)
    return [m["text"] for m in messages if m["type"] == "warning"]


def test_the_same_thing_clicked_in_a_second_photo_is_no_contradiction(scene: Scene, house: House, tmp_path: Path):
    once = warnings_with(scene, house, CLICKED[:1], tmp_path / "once")
    assert any(CLICKED[0] in text and "click the same spot in a second photo" in text for text in once)
    twice = warnings_with(scene, house, CLICKED, tmp_path / "twice")
    assert not any("contradict" in text for text in twice)
    # Taken for right, but the lawn around was clicked as not the building: no click is passed over in silence.
    assert all(any(name in text and "misses the clicks" in text for text in twice) for name in CLICKED)


def prompts_on(scene: Scene, spots: dict[str, list[np.ndarray]]) -> Prompts:
    found = {}
    for index, view in enumerate(scene.views):
        if view.name in spots:
            found[index] = Clicks(np.array([seen_at(scene, view.name, spot) for spot in spots[view.name]]))
    return found


@pytest.mark.parametrize(("apart", "left"), [(0.0, 0), (0.05, 0), (1.0, 2)])
def test_doubted_clicks_second_each_other_where_their_rays_meet(scene: Scene, apart: float, left: int):
    roof, off = np.array([0.0, 0.0, 3.2]), np.array([0.0, apart, 0.0])
    prompts = prompts_on(scene, {CLICKED[0]: [SPOT, roof], CLICKED[1]: [SPOT + off, roof]})
    outliers = [OutlierPrompt(index, True, 0, 0.05) for index in prompts]
    assert len(drop_confirmed(outliers, scene, prompts)) == left


def test_a_photo_of_another_building_needs_two_others(scene: Scene):
    """All clicks of each photo are outliers."""
    names = (*CLICKED, "photo_01.png")
    for count, left in ((2, 2), (3, 0)):
        prompts = prompts_on(scene, {name: [SPOT] for name in names[:count]})
        outliers = [OutlierPrompt(index, True, 0, 0.05) for index in prompts]
        assert len(drop_confirmed(outliers, scene, prompts)) == left


def test_clicks_that_are_not_doubted_second_only_where_points_are(scene: Scene):
    wall, roof = np.array([0.0, 1.5, 1.0]), np.array([0.0, 0.0, 3.2])
    for other, left in ((wall, 0), (SPOT, 1)):  # where no points are, rays of many clicks would meet by chance
        prompts = prompts_on(scene, {"photo_03.png": [other, roof], "photo_06.png": [other, roof]})
        outlier = OutlierPrompt(min(prompts), True, 0, 0.05)
        assert drop_confirmed([outlier], scene, prompts) == [outlier] * left
    beside = [OutlierPrompt(min(prompts), False, 0, 0.95)]
    assert drop_confirmed(beside, scene, prompts) == beside
