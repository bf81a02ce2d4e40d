# SPDX-License-Identifier: GPL-3.0-or-later
"""A background click on a passer-by before the wall contradicts no other photo; one on the wall itself does."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from benchmarks.synthetic.house import OFFSET
from mgf_engine.masks.prompts import Clicks
from mgf_engine.masks.propagation.prompt_messages import PromptMessages
from mgf_engine.masks.propagation.prompt_outliers import OutlierPrompt
from mgf_engine.masks.propagation.superpixels import cut_regions
from mgf_engine.masks.propagation.transient_prompts import TransientPromptOptions, is_transient
from mgf_engine.model.scene import Scene

PHOTO = 3
CLICK = OutlierPrompt(PHOTO, False, 0, 0.96)
WALL = np.array([0.0, 1.5, 0.9])  # metres, on the wall that the photo faces
OPTIONS = TransientPromptOptions()


def clicked(scene: Scene) -> np.ndarray:
    return scene.views[PHOTO].project(scene.to_normalised.apply(OFFSET[None] + WALL))[0]


def graph(scene: Scene, passer_by: bool) -> SimpleNamespace:
    """What a label graph knows of the colours, with somebody in a dark coat before the wall or without."""
    photos = [scene.photo(k) for k in range(len(scene.views))]
    if passer_by:
        x, y = np.floor(clicked(scene)[0]).astype(int).tolist()
        photos[PHOTO] = cv2.ellipse(photos[PHOTO].copy(), (x, y), (9, 26), 0, 0, 360, (40, 40, 60), -1)
    regions = [cut_regions(photo) for photo in photos]
    start = np.concatenate([[0], np.cumsum([len(r.area) for r in regions])])
    features = np.concatenate([r.features for r in regions])
    return SimpleNamespace(scene=scene, regions=regions, start=start, features=features)


@pytest.mark.parametrize("passer_by", [True, False])
def test_only_of_a_click_on_the_wall_is_said_that_it_contradicts_the_others(scene: Scene, passer_by: bool) -> None:
    prompts = {PHOTO: Clicks(np.zeros((0, 2)), clicked(scene))}
    messages = PromptMessages(graph(scene, passer_by), prompts, [])  # type: ignore[arg-type]
    said = messages.sentences([CLICK], [], ignored=True)
    assert said == [] if passer_by else ["The background clicks" in text for text in said] == [True]


@pytest.mark.parametrize(
    "change",
    [
        {"photos": 14},  # so many others there are not
        {"around": replace(OPTIONS.around, least_points=10_000)},  # then the depth is unknown
        {"color": 200.0},
    ],
)
def test_a_click_is_only_excused_by_photos_that_show_something_else(scene: Scene, change: dict[str, object]) -> None:
    prompts = {PHOTO: Clicks(np.zeros((0, 2)), clicked(scene))}
    options = replace(OPTIONS, **change)  # type: ignore[arg-type]
    assert not is_transient(CLICK, graph(scene, True), prompts, options)  # type: ignore[arg-type]
