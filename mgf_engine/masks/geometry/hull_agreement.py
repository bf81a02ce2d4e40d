# SPDX-License-Identifier: GPL-3.0-or-later
"""Compare masks with the visual hull of all the others: a leave-one-out test of masks that no sparse points test.

The hull is carved once. Each mask's own votes are then subtracted, so that the time grows with the number of photos and
not with its square.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.masks.geometry.visual_hull import (
    HullVotes,
    MaskHullOptions,
    background_distance,
    carve,
    vote_on_cells,
)
from mgf_engine.model.masks import IGNORE, MaskSet, building
from mgf_engine.model.scene import Scene, View


def hull_agreement(
    scene: Scene,
    masks: MaskSet,
    views: Sequence[int],
    tested: Sequence[int],
    options: MaskHullOptions = MaskHullOptions(),
) -> list[float | None]:
    """Compute the intersection over union of each mask tested and the visual hull of the other views' masks.

    Args:
        scene: the cameras.
        masks: the building in each photo.
        views: indices of the views whose masks carve the hull.
        tested: indices of the views whose masks are compared, each with the hull of ``views`` without it.
        options: of the hull.

    Returns:
        0..1 for each view tested; None if the hull of the others is empty or outside of this view's frame.
    """
    if not views or not tested:
        return [None] * len(tested)
    try:
        votes = carve(scene, masks, views, options, forgiven=1)  # the hulls of all others lie within
    except BadInput:
        return [None] * len(tested)
    result = []
    for index in tested:
        others = _without(votes, scene.views[index], masks.labels[index]) if index in views else votes
        result.append(_overlap(others.cells[others.hull(options)], votes.size, scene.views[index], masks.labels[index]))
    return result


def _without(votes: HullVotes, view: View, labels: NDArray[np.uint8]) -> HullVotes:
    """Return the votes without those of one view."""
    inside, outside = votes.inside.copy(), votes.outside.copy()
    framed, on_it, off_it = vote_on_cells(votes.cells, votes.size, view, labels, background_distance(labels))
    inside[framed] -= on_it
    outside[framed] -= off_it
    return HullVotes(votes.cells, votes.size, inside, outside)


def _overlap(cells: NDArray[np.float64], size: float, view: View, labels: NDArray[np.uint8]) -> float | None:
    """Return the intersection over union of a mask and the hull of cells [N, 3]; None where the view shows none."""
    uv, depth, framed = view.project_into_frame(cells)
    if not framed.any():
        return None
    cover = np.zeros((view.height, view.width), np.uint8)
    column, row = np.floor(uv[framed]).astype(int).T
    cover[row, column] = 1
    reach = int(np.ceil(size * view.fx / float(np.median(depth[framed])))) | 1
    hull = cv2.morphologyEx(cover, cv2.MORPH_CLOSE, np.ones((2 * reach + 1,) * 2, np.uint8)) > 0
    known, mask = labels != IGNORE, building(labels)
    return float((mask & hull & known).sum() / max(int(((mask | hull) & known).sum()), 1))
