# SPDX-License-Identifier: GPL-3.0-or-later
"""Outlier clicks: mistaken clicks, or all clicks in a photo of another building.

An outlier beside the building is used all the same, unless its photo was clicked on another building: it may be the
only one on a neighbour that looks like the building, and a mistake of that kind affects one mask at most.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.prompts import Clicks, Prompts
from mgf_engine.masks.propagation.label_graph import LabelGraph


@dataclass(frozen=True)
class OutlierPrompt:
    """An outlier click: view, kind, its row among the clicks of that kind, and the predicted probability there."""

    view: int
    positive: bool
    row: int
    probability: float

    def at(self, prompts: Prompts) -> NDArray[np.float64]:
        """Return where the click is, working pixels [2]."""
        clicks = prompts[self.view]
        return (clicks.positive if self.positive else clicks.negative)[self.row]


def ignored_outliers(outliers: list[OutlierPrompt], prompts: Prompts) -> list[OutlierPrompt]:
    """Return the outliers that are not used: those on the building, and all in photos of another building."""
    elsewhere = {click.view for click in outliers if clicked_elsewhere(click.view, outliers, prompts)}
    return [click for click in outliers if click.positive or click.view in elsewhere]


def clicked_elsewhere(view: int, outliers: Iterable[OutlierPrompt], prompts: Prompts) -> bool:
    """Tell whether all clicks on the building in a photo are outliers."""
    return sum(click.positive for click in outliers if click.view == view) == len(prompts[view].positive) > 0


def on_points(graph: LabelGraph, index: int, clicks: Clicks) -> bool:
    """Tell whether half of the positive clicks of a view are in regions with a sparse point, which tie it to others."""
    with_points = graph.observed[graph.scene.observations(index)] - graph.start[index]
    held = np.isin(graph.regions[index].at(clicks.positive), with_points)
    return bool(2 * held.sum() >= len(held))


def without_outliers(prompts: Prompts, outliers: Iterable[OutlierPrompt]) -> Prompts:
    """Return the prompts without the outliers."""
    result, outliers = dict(prompts), list(outliers)
    for index in {click.view for click in outliers}.intersection(prompts):
        clicks, kept = prompts[index], []
        for positive, points in ((True, clicks.positive), (False, clicks.negative)):
            drop = [click.row for click in outliers if click.view == index and click.positive == positive]
            kept.append(np.delete(points, drop, axis=0))
        result[index] = Clicks(kept[0], kept[1], clicks.parts)
    return result
