# SPDX-License-Identifier: GPL-3.0-or-later
"""Find outlier clicks by cross-validation: mistaken clicks, or a photo with clicks on another building.

The clicked photos are split into groups; the clicks of each group are predicted from those of the others. A click is an
outlier only if the prediction is certain of the opposite: clicks on parts that no other photo explains are kept.

An outlier beside the building is used all the same, unless its photo was clicked on another building: it may be the
only one on a neighbour that looks like the building, and a mistake of that kind affects one mask at most.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mgf_engine.masks.prompts import Clicks, Prompts
from mgf_engine.masks.propagation.label_graph import LabelGraph
from mgf_engine.masks.propagation.random_walker import LabelPropagation
from mgf_engine.native.parallel import parallel_map
from mgf_engine.options.algorithms import parameter

_EDGE_ARM = 10  # px that a click may lie over the edge


@dataclass(frozen=True)
class PromptOutlierOptions:
    """Options of the cross-validation of clicks."""

    groups: int = parameter(5, "Number of groups that the clicked photos are split into", low=2)
    rounds: int = parameter(2, "Number of rounds of label propagation in each test", low=1)
    passes: int = parameter(3, "Maximum number of passes; each leaves out what the one before found")
    certain: float = parameter(
        0.12,
        "Probability of building below which a click on it is an outlier; above 1 minus this, a click beside it",
        high=0.5,
    )


@dataclass(frozen=True)
class OutlierPrompt:
    """An outlier click: view, kind, its row among the clicks of that kind, and the predicted probability there."""

    view: int
    positive: bool
    row: int
    probability: float


def find_outlier_prompts(
    walker: LabelPropagation, prompts: Prompts, seed: int, options: PromptOutlierOptions = PromptOutlierOptions()
) -> list[OutlierPrompt]:
    """Find the clicks that those in other photos contradict; none with fewer than three clicked photos.

    Outliers disturb the test of other clicks, so they are left out and the rest is tested again. The first pass, which
    is usually the only one, evaluates the geometry of the clicked photos only, which takes a fifth of the time.

    Args:
        walker: label propagation of the scene.
        prompts: clicks by view index.
        seed: of the propagation.
        options: number of groups and passes.
    """
    found: list[OutlierPrompt] = []
    kept = prompts
    for number in range(options.passes):
        new = _one_pass(walker, kept, seed, clicked_alone=number == 0, options=options)
        if not new:
            break
        found += [_original_row(d, prompts, kept) for d in new]
        kept = without_outliers(prompts, found)
    return found


def ignored_outliers(outliers: list[OutlierPrompt], prompts: Prompts) -> list[OutlierPrompt]:
    """Return the outliers that are not used: those on the building, and all in photos of another building."""
    elsewhere = {click.view for click in outliers if clicked_elsewhere(click.view, outliers, prompts)}
    return [click for click in outliers if click.positive or click.view in elsewhere]


def clicked_elsewhere(view: int, outliers: list[OutlierPrompt], prompts: Prompts) -> bool:
    """Tell whether all clicks on the building in a photo are outliers."""
    return sum(click.positive for click in outliers if click.view == view) == len(prompts[view].positive) > 0


def on_points(graph: LabelGraph, index: int, clicks: Clicks) -> bool:
    """Tell whether half of the positive clicks of a view are in regions with a sparse point, which tie it to others."""
    with_points = graph.observed[graph.scene.observations(index)] - graph.start[index]
    held = np.isin(graph.regions[index].at(clicks.positive), with_points)
    return bool(2 * held.sum() >= len(held))


def _original_row(outlier: OutlierPrompt, prompts: Prompts, kept: Prompts) -> OutlierPrompt:
    """Return the outlier with its row among all clicks, not only those still tested."""
    before, after = prompts[outlier.view], kept[outlier.view]
    all_clicks = before.positive if outlier.positive else before.negative
    click = (after.positive if outlier.positive else after.negative)[outlier.row]
    row = int(np.flatnonzero((all_clicks == click).all(1))[0])
    return OutlierPrompt(outlier.view, outlier.positive, row, outlier.probability)


def _one_pass(
    walker: LabelPropagation, prompts: Prompts, seed: int, clicked_alone: bool, options: PromptOutlierOptions
) -> list[OutlierPrompt]:
    clicked = [i for i in sorted(prompts) if len(prompts[i].positive) or len(prompts[i].negative)]
    if len(clicked) < 3:
        return []
    count = min(options.groups, len(clicked))

    def against(group: int) -> list[OutlierPrompt]:
        held = clicked[group::count]
        others = {i: c for i, c in prompts.items() if i not in held}
        if not any(len(c.positive) for c in others.values()):
            return []
        probability = walker.solve(others, seed, options.rounds, clicked if clicked_alone else None)
        return [
            outlier for i in held for outlier in _against(walker.graph, probability.regions[i], i, prompts[i], options)
        ]

    return [outlier for found in parallel_map(against, range(count), walker.graph.threads) for outlier in found]


def without_outliers(prompts: Prompts, outliers: list[OutlierPrompt]) -> Prompts:
    """Return the prompts without the outliers."""
    result = dict(prompts)
    for index in {click.view for click in outliers}:
        clicks, kept = prompts[index], []
        for positive, points in ((True, clicks.positive), (False, clicks.negative)):
            drop = [click.row for click in outliers if click.view == index and click.positive == positive]
            kept.append(np.delete(points, drop, axis=0))
        result[index] = Clicks(kept[0], kept[1], clicks.parts)
    return result


def _against(
    graph: LabelGraph, regions: np.ndarray, index: int, clicks: Clicks, options: PromptOutlierOptions
) -> list[OutlierPrompt]:
    outliers = []
    for positive, points in ((True, clicks.positive), (False, clicks.negative)):
        for row, click in enumerate(points):
            # A click a few pixels over the edge is no contradiction: take the kindest neighbour.
            here = regions[graph.regions[index].at_cross(click, _EDGE_ARM)]
            probability = float(here.max() if positive else here.min())
            if (probability < options.certain) if positive else (probability > 1 - options.certain):
                outliers.append(OutlierPrompt(index, positive, row, probability))
    return outliers
