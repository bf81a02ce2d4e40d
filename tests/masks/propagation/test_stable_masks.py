# SPDX-License-Identifier: GPL-3.0-or-later
"""The mask of one photo follows its clicks: no click on the building loses it, and every click is obeyed."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.synthetic.house import House
from mgf_engine.cli.main import main
from mgf_engine.masks import preview
from mgf_engine.masks.prompts import Clicks
from mgf_engine.masks.propagation.stable_masks import enforce_clicks, first_clicks, merge_masks, set_clicked_pixels
from mgf_engine.masks.propagation.superpixels import cut_regions
from mgf_engine.masks.segmenters.base import Hints, Segment

NONE = np.zeros((0, 2))


def square(low: int, high: int) -> np.ndarray:
    mask = np.zeros((100, 100), bool)
    mask[low:high, low:high] = True
    return mask


def at(mask: np.ndarray, points: list) -> list[bool]:
    return [bool(mask[int(v), int(u)]) for u, v in points]


def test_the_first_clicks_keep_those_beside_the_building() -> None:
    clicks = Clicks(np.arange(6.0).reshape(3, 2), np.array([[9.0, 9]]))
    assert [len(c.positive) for c in first_clicks(clicks)] == [1, 2, 3]
    assert all(c.negative.tolist() == [[9, 9]] for c in first_clicks(clicks))


def test_a_click_may_correct_the_mask_but_not_lose_it() -> None:
    whole, corrected, lost, other = square(10, 90), square(12, 88), square(40, 50), square(0, 9)
    assert (merge_masks([whole, corrected]) == corrected).all()
    assert (merge_masks([whole, lost]) == whole).all()
    assert (merge_masks([whole, other]) == (whole | other)).all()
    assert (merge_masks([lost, whole, lost]) == whole).all()
    # One click more never takes away more than a correction, whatever the answers are.
    rng = np.random.default_rng(5)
    masks = [rng.random((20, 20)) < share for share in rng.random(30)]
    for n in range(1, len(masks)):
        before, after = merge_masks(masks[:n]), merge_masks(masks[: n + 1])
        assert (before & after).sum() >= 0.8 * before.sum()


def test_every_click_is_obeyed_with_its_region() -> None:
    rng = np.random.default_rng(1)
    photo = rng.integers(0, 255, (120, 160, 3), np.uint8)
    regions = cut_regions(photo)
    for _ in range(20):
        clicks = Clicks(rng.uniform(1, 119, (5, 2)), rng.uniform(1, 119, (5, 2)))
        mask = enforce_clicks(rng.random((120, 160)) < 0.5, regions, clicks)
        assert all(at(mask, clicks.positive)) and not any(at(mask, clicks.negative))
    alone = enforce_clicks(np.zeros((120, 160), bool), regions, Clicks(np.array([[80.0, 60]]), NONE))
    assert 20 < alone.sum() < 800


def test_clicks_a_pixel_apart_are_both_obeyed() -> None:
    clicks = Clicks(np.array([[30.2, 40.7]]), np.array([[31.4, 40.7]]))
    for mask in (np.zeros((80, 80), bool), np.ones((80, 80), bool)):
        found = set_clicked_pixels(mask, clicks)
        assert at(found, clicks.positive) == [True] and at(found, clicks.negative) == [False]


@pytest.mark.parametrize("answer", ["nothing", "everything", "the other way round", "lost by the last click"])
def test_the_preview_obeys_whatever_the_segmenter_says(
    house: House, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, answer: str
) -> None:
    """The 24 %, 1 %, 4 % and 40 % of one photo, as far as a segmenter can bring them about."""
    name = sorted(json.loads(house.prompts.read_text()))[0]
    truth = house.masks[name]
    inner = np.argwhere(cv2.erode(truth.astype(np.uint8), np.ones((9, 9))) > 0)[:, ::-1] + 0.5
    outer = np.argwhere(cv2.dilate(truth.astype(np.uint8), np.ones((9, 9))) == 0)[:, ::-1] + 0.5
    rng = np.random.default_rng(3)
    clicks = {"positive": rng.permutation(inner)[:4].tolist(), "negative": rng.permutation(outer)[:3].tolist()}

    class Segmenter:
        def segment(self, photo: np.ndarray, hints: Hints, attempt: int = 0) -> Segment:
            shape = photo.shape[:2]
            mask = np.zeros(shape, bool)
            if answer == "everything":
                mask[:] = True
            elif answer != "nothing":
                small = cv2.resize(truth.astype(np.uint8), shape[::-1], interpolation=cv2.INTER_NEAREST) > 0
                lost = answer == "lost by the last click" and len(hints.positive) == len(clicks["positive"])
                mask = ~small if answer == "the other way round" else small & (not lost)
            return Segment(mask, 1.0)

    monkeypatch.setattr(preview, "choose_segmenter", lambda *given: Segmenter())
    (tmp_path / "clicks.json").write_text(json.dumps({name: clicks}))
    command = ["preview", str(house.folder), "--prompts", str(tmp_path / "clicks.json"), "--image", name]
    assert main([*command, "--out", str(tmp_path / "mask.png"), "--resolution", "8192"]) == 0
    mask = cv2.imread(str(tmp_path / "mask.png"), cv2.IMREAD_UNCHANGED) > 0
    assert mask.shape == truth.shape
    assert all(at(mask, clicks["positive"])) and not any(at(mask, clicks["negative"]))
    if answer == "lost by the last click":
        assert (mask & truth).sum() > 0.95 * truth.sum()
