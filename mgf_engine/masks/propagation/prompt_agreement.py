# SPDX-License-Identifier: GPL-3.0-or-later
"""Find outlier clicks that clicks in other photos confirm: both are on the same object, so it was clicked on purpose.

Two clicks are on the same object if their rays intersect in front of both cameras. Two outliers rarely do so by chance,
but some click on the building usually lies near the ray of a mistaken click. So for a pair with a click that is no
outlier, the intersection must be at the depth of the sparse points near both clicks.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.prompts import Prompts
from mgf_engine.masks.propagation.prompt_outliers import OutlierPrompt, clicked_elsewhere
from mgf_engine.model.scene import Scene, View
from mgf_engine.options.algorithms import parameter

_Click = tuple[int, int]  # view, row among its clicks on the building


class DepthRange(NamedTuple):
    """Depths of the sparse points that a photo shows around a click, and their numbers."""

    nearest: float
    farthest: float
    points: NDArray[np.int64]


@dataclass(frozen=True)
class PromptAgreementOptions:
    """Options of clicks in several photos that confirm each other."""

    near: float = parameter(
        0.06, "Radius around a click in which sparse points bound its depth, as a share of the photo's width", high=1
    )
    least_points: int = parameter(3, "Minimum number of sparse points around a click", low=1)
    reach: float = parameter(
        0.05, "Maximum distance between two clicks on one thing, as a share of the distance from the camera", high=1
    )
    gap: float = parameter(
        0.02, "Maximum distance between the rays of two outlier clicks, as a share of the distance", high=1
    )


def drop_confirmed(
    outliers: list[OutlierPrompt],
    scene: Scene,
    prompts: Prompts,
    options: PromptAgreementOptions = PromptAgreementOptions(),
) -> list[OutlierPrompt]:
    """Return the outliers without the clicks on the building that other photos confirm.

    One other photo is enough; two if all clicks on the building in a photo are outliers, as after clicking on another
    building.

    Args:
        outliers: clicks that cross-validation found wrong.
        scene: tracks of the sparse points.
        prompts: all clicks, by view index.
        options: distances.
    """
    on_building = {(click.view, click.row) for click in outliers if click.positive}
    if not on_building:
        return outliers
    places = {
        (i, row): depth_range(scene, i, uv, options)
        for i, clicks in prompts.items()
        for row, uv in enumerate(clicks.positive)
    }
    seconds: dict[_Click, set[int]] = {click: set() for click in on_building}
    for first, second in combinations(places, 2):
        if first[0] == second[0] or not {first, second} & on_building:
            continue
        both = {first, second} <= on_building
        if _same_thing(scene, prompts, first, second, None if both else places, options):
            for click, other in ((first, second), (second, first)):
                seconds.get(click, set()).add(other[0])
    kept = []
    for outlier in outliers:
        needed = 2 if clicked_elsewhere(outlier.view, outliers, prompts) else 1
        if not outlier.positive or len(seconds[outlier.view, outlier.row]) < needed:
            kept.append(outlier)
    return kept


def depth_range(
    scene: Scene, index: int, uv: NDArray[np.float64], options: PromptAgreementOptions = PromptAgreementOptions()
) -> DepthRange | None:
    """Bound the depth of a click by the sparse points that its photo shows around it; None where they are too few.

    Args:
        scene: tracks of the sparse points.
        index: of the photo.
        uv: the click, working pixels [2].
        options: how far around it points count, and how many are enough.
    """
    rows, view = scene.observations(index), scene.views[index]
    beside = np.linalg.norm(scene.track_uv[rows] - uv, axis=1) < options.near * view.width
    if beside.sum() < options.least_points:
        return None
    points = scene.track_point[rows[beside]]
    depth = view.project(scene.points[points])[1]
    return DepthRange(float(depth.min()), float(depth.max()), points)


def _same_thing(
    scene: Scene,
    prompts: Prompts,
    first: _Click,
    second: _Click,
    distances: dict[_Click, DepthRange | None] | None,
    options: PromptAgreementOptions,
) -> bool:
    """Tell whether the rays of two clicks meet and, with ``distances``, at the depth of the points beside both."""
    (a, along_a), (b, along_b) = (_ray(scene.views[i], prompts[i].positive[row]) for i, row in (first, second))
    meeting = np.linalg.lstsq(np.stack([along_a, -along_b], 1), b - a, rcond=None)[0]
    if meeting.min() <= 0:
        return False
    gap = np.linalg.norm(a + meeting[0] * along_a - b - meeting[1] * along_b)
    if distances is None:
        return bool(gap <= options.gap * meeting.min())
    for along, known in zip(meeting, (distances[first], distances[second]), strict=True):
        reach = options.reach * along
        if known is None or not known.nearest - reach <= along <= known.farthest + reach:
            return False
    return bool(gap <= options.reach * meeting.min())


def _ray(view: View, uv: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return camera centre and direction [3] of a pixel; the direction's length is 1 along the optical axis."""
    local = np.array([(uv[0] - view.cx) / view.fx, (uv[1] - view.cy) / view.fy, 1.0])
    return view.centre, view.rotation.T @ local
