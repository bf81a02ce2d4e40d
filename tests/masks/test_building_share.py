# SPDX-License-Identifier: GPL-3.0-or-later
"""The share that the clicks on a rectangle and around it speak of."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mgf_engine.masks.building_share import building_share
from mgf_engine.masks.prompts import PromptsFile

SIZE = (600, 400)
RECTANGLE = np.array([150.0, 100.0]), np.array([450.0, 300.0])  # a quarter of the photo


def share(*photos: dict, size: tuple[int, int] = SIZE) -> float | None:
    content = json.dumps({f"{number}.jpg": photo for number, photo in enumerate(photos)})
    return building_share(PromptsFile(Path("prompts.json"), content.encode()), size)


def clicks(scale: float = 1.0, beside: bool = True, margin: float = 0.25) -> dict:
    """Clicks well within a rectangle, as people set them, and along the photo's border."""
    inset = margin * (RECTANGLE[1] - RECTANGLE[0])
    low, high = RECTANGLE[0] + inset, RECTANGLE[1] - inset
    on = np.stack(np.meshgrid(*(np.linspace(a, b, 4) for a, b in zip(low, high, strict=True))), -1).reshape(-1, 2)
    off = np.array([(x, y) for x in (20, 200, 400, 580) for y in (20, 380)] + [(20, 200), (580, 200)], float)
    found = {"positive": on, "negative": off if beside else np.zeros((0, 2))}
    return {kind: (scale * at).tolist() for kind, at in found.items()}


def few() -> dict:
    return {"positive": [[10, 10], [590, 390]], "negative": [[300, 200]]}


@pytest.mark.parametrize(
    "content", [b"", b"{", b"[]", b"3", b'{"a": 3}', b'{"a": {"positive": [1, 2, 3]}}', b"[" * 10_000]
)
def test_damaged_files_tell_nothing(content: bytes) -> None:
    assert building_share(PromptsFile(Path("prompts.json"), content), SIZE) is None


def test_few_clicks_tell_nothing() -> None:
    assert share() is None and share(few()) is None and share({"negative": [[1, 1]] * 5}) is None


def test_a_rectangle_has_nearly_its_share() -> None:
    assert share(clicks()) == pytest.approx(0.25, rel=0.25)


def test_clicks_beside_the_building_keep_its_share_small() -> None:
    found, without = share(clicks(margin=0.1)), share(clicks(margin=0.1, beside=False))
    assert found is not None and without is not None and found < without


def test_the_unit_does_not_matter() -> None:
    assert share(clicks(3.0), size=(1800, 1200)) == pytest.approx(share(clicks()))


@pytest.mark.parametrize("upright", [False, True])
def test_the_place_in_the_photo_does_not_matter(upright: bool) -> None:
    """Clicks at either end of the photo's long side."""
    ends = [
        {"positive": [[x, y][:: -1 if upright else 1] for x in (0, 60, 120) for y in (150, 200, 250)]} for _ in "ab"
    ]
    for at in ends[1]["positive"]:
        at[upright] = 600 - at[upright]
    assert share(ends[0]) == pytest.approx(share(ends[1]), rel=0.05)


def test_photos_with_few_clicks_do_not_count() -> None:
    assert share(clicks(), few(), clicks()) == pytest.approx(share(clicks()))
