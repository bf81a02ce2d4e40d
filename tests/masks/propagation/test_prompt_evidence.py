# SPDX-License-Identifier: GPL-3.0-or-later
"""What denies a click on the building, in two photos of ten regions, each ten pixels wide and with a point."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mgf_engine.masks.geometry.point_features import PointFeatureOptions
from mgf_engine.masks.prompts import Clicks, Prompts
from mgf_engine.masks.propagation.prompt_evidence import PromptEvidence
from mgf_engine.masks.propagation.prompt_outliers import OutlierPrompt

REGIONS = 10
SUSPECT = OutlierPrompt(0, True, 1, 0.05)


def at(*regions: int) -> np.ndarray:
    return np.array([[10.0 * region + 5, 5.0] for region in regions]).reshape(-1, 2)


PROMPTS = {0: Clicks(at(2, 3), at(8)), 1: Clicks(at(4, 5), at(9))}


class Walker:
    """Random walks end at clicks with given probabilities; point ``k`` is seen in region ``k`` of both photos.

    Args:
        building, background: these probabilities, of all regions.
        apart: whether points from region 3 on are far from the others.
    """

    def __init__(self, building: float, background: float, apart: bool = False) -> None:
        self.ends = np.full(3 * REGIONS, building), np.full(3 * REGIONS, background)
        self.asked: list[Prompts] = []
        regions = SimpleNamespace(at_cross=lambda uv, arm: np.full(5, int(uv[0] // 10)))
        points = np.zeros((REGIONS, 3))
        points[:, 0] = np.arange(REGIONS) + 100 * apart * (np.arange(REGIONS) == 3)
        self.graph: Any = SimpleNamespace(
            regions=[regions, regions], start=np.array([0, REGIONS, 2 * REGIONS]), region_count=2 * REGIONS,
            point_count=REGIONS, sky=np.zeros(3 * REGIONS, int), plants=np.zeros(3 * REGIONS), click_pull=self.ask,
            points_at=lambda index, uv: (uv[:, 0] // 10).astype(int), clicked_points=self.clicked_points,
            scene=SimpleNamespace(points=points), options=SimpleNamespace(features=PointFeatureOptions()),
            point_features=SimpleNamespace(spacing=np.ones(REGIONS)),
        )  # fmt: skip

    def ask(self, prompts: Prompts) -> tuple[np.ndarray, np.ndarray]:
        self.asked.append(prompts)
        return np.zeros(3 * REGIONS), np.zeros(3 * REGIONS)

    def fading_walks(self, pull: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.ends

    def clicked_points(self, prompts: Prompts) -> np.ndarray:
        return np.concatenate([(c.positive[:, 0] // 10).astype(int) for c in prompts.values()])


def denied(walker: Any, suspects: list[OutlierPrompt], prompts: Prompts = PROMPTS) -> list[OutlierPrompt]:
    return PromptEvidence(walker, prompts, None).find_denied(suspects)


@pytest.mark.parametrize(
    ("building", "background", "expected"),
    [(0.1, 0.2, True), (0.2, 0.1, False), (0.0, 0.0, False), (0.0, 0.0005, False), (0.0, 0.002, True)],
)
def test_only_clicks_beside_the_building_deny_one_on_it(building: float, background: float, expected: bool):
    assert denied(Walker(building, background), [SUSPECT]) == ([SUSPECT] if expected else [])


@pytest.mark.parametrize(("building", "expected"), [(0.0, 2), (0.0005, 2), (0.01, 0)])
def test_a_photo_all_of_whose_clicks_are_suspects_needs_the_support_of_others(building: float, expected: int):
    assert len(denied(Walker(building, 0.0), [OutlierPrompt(0, True, row, 0.05) for row in range(2)])) == expected


def test_the_only_click_on_the_building_in_a_photo_needs_no_support():
    prompts = {0: Clicks(at(2), at(8)), 1: Clicks(at(4, 5), at(9))}
    alone, beside = OutlierPrompt(0, True, 0, 0.05), OutlierPrompt(0, False, 0, 0.95)
    assert denied(Walker(0.0, 0.0), [alone], prompts) == []
    assert denied(Walker(0.0, 0.0), [alone, beside], prompts) == [alone]  # clicked the other way round


def test_suspects_deny_nothing():
    walker = Walker(0.0, 0.0)
    assert denied(walker, [SUSPECT, OutlierPrompt(1, False, 0, 0.95)]) == []
    assert all(len(asked[0].positive) == 1 and len(asked[1].negative) == 0 for asked in walker.asked)


@pytest.mark.parametrize("apart", [False, True])
def test_clicks_on_sky_say_nothing_of_a_part_that_hangs_together_with_the_building(apart: bool):
    """All clicks beside the building are on sky; the walk that knows them denies, the one without them does not."""
    walker = Walker(0.0, 0.0, apart)
    walker.graph.sky[[8, REGIONS + 9]] = 1

    def walk(pull: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        known = any(len(clicks.negative) for clicks in walker.asked[-1].values())
        return np.zeros(3 * REGIONS), np.full(3 * REGIONS, 0.1 * known)

    walker.fading_walks = walk  # type: ignore[method-assign]
    assert denied(walker, [SUSPECT]) == ([SUSPECT] if apart else [])


@pytest.mark.parametrize(
    ("sky", "plants", "ground", "expected"),
    [
        ((0, 0, 0), (0, 0, 0), 0.0, False),
        ((7, 7, 7), (0, 0, 0), 0.0, True),
        ((0, 0, 0), (0.9, 0.9, 0.9), 0.0, True),
        ((7, 0, 0), (0, 0.9, 0.9), 0.0, True),
        ((0, 0, 0), (0.9, 0.1, 0.9), 0.0, False),  # a wall that shows between leaves
        ((0, 0, 0), (0, 0, 0), 0.9, True),
    ],
)
def test_a_click_on_sky_leaves_or_ground_lies_on_background(
    sky: tuple[int, ...], plants: tuple[float, ...], ground: float, expected: bool
):
    walker: Any = Walker(0.5, 0.0)
    graph = walker.graph
    graph.regions = [SimpleNamespace(at_cross=lambda uv, arm: np.array([2, 3, 4]))]
    graph.sky[2:5], graph.plants[2:5] = sky, plants
    plane: Any = SimpleNamespace(
        membership=lambda scene, features: np.where(np.arange(REGIONS) == 3, ground, 0.0),
        height=lambda points: np.ones(REGIONS), thickness=0.01,
    )  # fmt: skip
    assert PromptEvidence(walker, PROMPTS, plane).on_background(0, at(3)[0]) is expected
    assert PromptEvidence(walker, PROMPTS, None).on_background(0, at(3)[0]) is (expected and not ground)
