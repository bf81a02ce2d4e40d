# SPDX-License-Identifier: GPL-3.0-or-later
"""Find given masks that contradict the others: of another photo, of a neighbouring building, upside down.

Photos that observe the same sparse point must agree whether it belongs to the building. A mask that the others
contradict is not used in training; masks that contradict each other without a majority are refused.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.masks.image_ops import disc
from mgf_engine.masks.points import LabelMaps
from mgf_engine.model.masks import IGNORE, building
from mgf_engine.model.pixels import pixel_at
from mgf_engine.model.scene import Scene
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class CrossViewOptions:
    """Options of the comparison of masks."""

    contradicted: float = parameter(
        0.35,
        "Agreement with the other masks below which a mask is left out (1 full agreement, 0 a random mask)",
        low=-1,
        high=1,
    )
    consistent: float = parameter(0.6, "Minimum agreement of the other masks among themselves", low=-1, high=1)
    least_points: int = parameter(15, "Minimum number of points for the agreement of a mask", low=1)


def find_contradicted_masks(
    scene: Scene,
    labels: LabelMaps,
    used: NDArray[np.bool_],
    dilation: int,
    options: CrossViewOptions = CrossViewOptions(),
) -> dict[int, float]:
    """Find views whose mask the others contradict, with their agreement.

    The worst third is taken out at a time: wrong masks make right ones look wrong, too.

    Args:
        scene: its points, and the views that observed each.
        labels: label maps of all views.
        used: bool [V], the views that have a mask.
        dilation: masks grow by this before observations are tested, px.
        options: how many points must agree, and from which share on a mask is contradicted.

    Raises:
        BadInput: the masks contradict each other, and there is no majority.
    """
    observed = _observed_labels(scene, labels, used, dilation)
    owner = scene.track_point
    found: dict[int, float] = {}
    while True:
        votes = np.where(np.isin(scene.track_view, list(found)), 0, observed)
        total = np.asarray(np.bincount(owner, votes, len(scene.points)), np.float64)
        rows = (scene.observations(i) for i in range(len(scene.views)))
        score = np.array([_agreement(owner[i], observed[i], votes[i], total, options.least_points) for i in rows])
        score[list(found)] = np.nan
        low = np.flatnonzero(score < options.contradicted)
        if not len(low):
            return found
        if np.nanpercentile(score, 75) < options.consistent:
            raise BadInput(
                "The given masks contradict each other about which points are on the building; check that each "
                "mask belongs to its photo and shows the same building."
            )
        worst = low[np.argsort(score[low], kind="stable")][: -(-len(low) // 3)]
        found |= {int(i): float(score[i]) for i in worst}


def _observed_labels(scene: Scene, labels: LabelMaps, used: NDArray[np.bool_], dilation: int) -> NDArray[np.int8]:
    """Look up each observation in the mask, [T]: 1 building, -1 background, 0 unknown."""
    result = np.zeros(len(scene.track_view), np.int8)
    for index in np.flatnonzero(used).tolist():
        here = scene.observations(index)
        y, x = pixel_at(labels[index].shape, scene.track_uv[here])
        grown = cv2.dilate(building(labels[index]).astype(np.uint8), disc(dilation)) > 0
        background = ~grown[y, x] & (labels[index][y, x] != IGNORE)
        result[here] = grown[y, x].astype(np.int8) - background.astype(np.int8)
    return result


def _agreement(
    points: NDArray[np.int64],
    observed: NDArray[np.int8],
    votes: NDArray[np.int8],
    total: NDArray[np.float64],
    least: int,
) -> float:
    """Compute the agreement of a view with the majority of the trusted others, 1 (all points) to 0 (a random mask).

    It is sensitivity plus specificity less 1; with too few points on one side, twice the other rate less 1; NaN with
    too few points on both.

    Args:
        points: that the view observed, [N]; a point may stand twice.
        observed: what its mask says of them, [N], see :func:`_observed_labels`.
        votes: the same, 0 where the view is not trusted.
        total: sum of the votes of all views on each point of the scene, [P].
        least: number of points that are enough.
    """
    own, place = np.unique(points, return_inverse=True)
    others = total[points] - np.bincount(place, votes, len(own))[place]
    mine = (observed != 0) & (others != 0)
    if mine.sum() < least:
        return float("nan")
    right, inside = np.sign(others[mine]) == observed[mine], others[mine] > 0
    shares = [right[side].mean() for side in (inside, ~inside) if side.sum() >= least]
    return float(2 * np.mean(shares) - 1) if shares else float("nan")
