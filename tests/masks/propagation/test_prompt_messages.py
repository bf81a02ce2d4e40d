# SPDX-License-Identifier: GPL-3.0-or-later
"""Sentences about clicks: an ignored click is mentioned only where the mask misses it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mgf_engine.masks.prompts import Clicks
from mgf_engine.masks.propagation.prompt_messages import PromptMessages
from mgf_engine.masks.propagation.prompt_outliers import OutlierPrompt
from mgf_engine.model.masks import BACKGROUND, BUILDING, IGNORE
from tests.support.small_scene import make_scene, view

CLICKS = np.array([[3.5, 2.5], [12.5, 2.5]])  # pixels
SCENE = make_scene([view("a.jpg", 0.0), view("b.jpg", 0.1)], np.zeros((0, 3)), [])
REGIONS = SimpleNamespace(at=lambda uv: np.zeros(len(uv), int))
GRAPH = SimpleNamespace(scene=SCENE, observed=np.zeros(0, int), start=np.zeros(3, int), regions=[REGIONS, REGIONS])


def sentences(label_at_second: int) -> list[str]:
    """What is said when the second of two clicks on the building is an outlier."""
    labels = [np.full((10, 20), BUILDING, np.uint8) for _ in SCENE.views]
    labels[0][2, 12] = label_at_second
    prompts = {0: Clicks(CLICKS, np.zeros((0, 2))), 1: Clicks(CLICKS, np.zeros((0, 2)))}
    messages = PromptMessages(GRAPH, prompts, labels)  # type: ignore[arg-type]
    return messages.sentences([OutlierPrompt(0, True, 1, 0.05)], [], ignored=True)


def test_an_ignored_click_beside_the_mask_is_said() -> None:
    (text,) = sentences(BACKGROUND)
    assert "a.jpg" in text and "are ignored" in text and "(12, 2)" in text


@pytest.mark.parametrize("label", [BUILDING, IGNORE])
def test_an_ignored_click_that_the_mask_has_all_the_same_is_not(label: int) -> None:
    assert sentences(label) == []
