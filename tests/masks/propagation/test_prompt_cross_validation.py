# SPDX-License-Identifier: GPL-3.0-or-later
"""Clicks are outliers where those in the other photos are certain of the opposite."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np
import pytest

from mgf_engine.masks.prompts import Clicks, Prompts
from mgf_engine.masks.propagation import prompt_cross_validation
from mgf_engine.masks.propagation.prompt_cross_validation import PromptCrossValidation, PromptOutlierOptions
from mgf_engine.masks.propagation.prompt_outliers import OutlierPrompt


class Walker:
    """Predicts one probability a photo, and notes from which photos it was asked to."""

    def __init__(self, probability: Sequence[float]) -> None:
        regions = SimpleNamespace(at_cross=lambda uv, arm: np.zeros(5, np.int64))
        self.graph = SimpleNamespace(threads=1, regions=[regions] * len(probability))
        self.predicted = [np.array([p]) for p in probability]
        self.asked: list[tuple[list[int], object]] = []

    def solve(self, prompts: Prompts, seed: int, rounds: int, views: object) -> SimpleNamespace:
        self.asked.append((sorted(prompts), views))
        return SimpleNamespace(regions=self.predicted, ground=None)


def clicks(on: int = 1, off: int = 0) -> Clicks:
    return Clicks(np.ones((on, 2)), np.ones((off, 2)))


@pytest.fixture
def deny(monkeypatch: pytest.MonkeyPatch) -> set[int]:
    """The photos whose clicks on the building evidence denies."""
    denied: set[int] = set()

    class Evidence:
        def __init__(self, *given: object) -> None:
            pass

        def find_denied(self, tested: list[OutlierPrompt]) -> list[OutlierPrompt]:
            return [click for click in tested if click.view in denied]

    monkeypatch.setattr(prompt_cross_validation, "PromptEvidence", Evidence)
    return denied


def test_two_photos_cannot_judge_each_other(deny: set[int]) -> None:
    walker = Walker([0.0, 0.0])
    found = PromptCrossValidation(walker, {0: clicks(), 1: clicks()}).run()  # type: ignore[arg-type]
    assert found == ([], []) and not walker.asked


def test_a_click_on_the_building_needs_evidence_against_it(deny: set[int]) -> None:
    prompts = {k: clicks() for k in range(4)}
    tested = PromptCrossValidation(Walker([0.9, 0.9, 0.05, 0.9]), prompts)  # type: ignore[arg-type]
    outliers, kept = tested.run()
    assert not outliers and [(c.view, c.positive) for c in kept] == [(2, True)]
    deny.add(2)
    outliers, kept = tested.run()
    assert not kept and [(c.view, c.positive, c.row) for c in outliers] == [(2, True, 0)]
    assert outliers[0].probability == pytest.approx(0.05)


def test_a_click_beside_the_building_needs_none(deny: set[int]) -> None:
    prompts = {0: clicks(), 1: clicks(), 2: clicks(1, 2)}
    outliers, kept = PromptCrossValidation(Walker([0.9, 0.9, 0.95]), prompts).run()  # type: ignore[arg-type]
    assert not kept and [(c.view, c.positive, c.row) for c in outliers] == [(2, False, 0), (2, False, 1)]


@pytest.mark.parametrize("probability,suspected", [(0.119, True), (0.121, False)])
def test_only_a_certain_prediction_makes_a_suspect(deny: set[int], probability: float, suspected: bool) -> None:
    prompts = {k: clicks() for k in range(3)}
    walker = Walker([0.9, probability, 0.9])
    kept = PromptCrossValidation(walker, prompts, options=PromptOutlierOptions(certain=0.12)).run().kept  # type: ignore[arg-type]
    assert bool(kept) == suspected


def test_no_click_predicts_itself_and_each_is_predicted_once_a_pass(deny: set[int]) -> None:
    walker = Walker([0.9] * 7)
    PromptCrossValidation(walker, {k: clicks() for k in range(7)}).run()  # type: ignore[arg-type]
    held_out = [set(range(7)) - set(used) for used, _ in walker.asked]
    assert len(held_out) == 5 and sorted(k for held in held_out for k in held) == list(range(7))


def test_uncertain_clicks_are_tested_again_without_the_outliers(deny: set[int]) -> None:
    prompts = {0: clicks(), 1: clicks(), 2: clicks(1, 1), 3: clicks()}
    walker = Walker([0.9, 0.5, 0.95, 0.9])  # photo 2's click beside the building is wrong, photo 1 is uncertain
    outliers, _ = PromptCrossValidation(walker, prompts).run()  # type: ignore[arg-type]
    assert [(c.view, c.positive) for c in outliers] == [(2, False)]
    first, second = walker.asked[:4], walker.asked[4:]
    assert all(views == [0, 1, 2, 3] for _, views in first)
    assert [(used, views) for used, views in second] == [([0, 2, 3], None)]


def test_it_asks_whether_to_stop(deny: set[int]) -> None:
    def stop() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        PromptCrossValidation(Walker([0.9] * 3), {k: clicks() for k in range(3)}).run(stop)  # type: ignore[arg-type]
