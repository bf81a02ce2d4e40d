# SPDX-License-Identifier: GPL-3.0-or-later
"""Find ignored pieces of masks that are the building itself: all photos ignore the same place of its surface.

What stands before the building hides another place of it in each photo. A door in a colour of its own, which the masks
take neither for building nor for background, is ignored by all. So is a shrub close to a wall; but it has leaves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.points import LabelMaps, observed_pixels
from mgf_engine.masks.prompts import Prompts
from mgf_engine.model.masks import IGNORE
from mgf_engine.model.pixels import pixel_at
from mgf_engine.model.scene import Scene
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class IgnoredSurfaceOptions:
    """Options of ignored pieces that are the building."""

    photos: int = parameter(3, "Minimum number of photos that ignore a point on the surface, and none that does not",
                            low=1)  # fmt: skip
    points: int = parameter(5, "Minimum number of such points in a piece of a mask", low=1)
    share: float = parameter(0.5, "Minimum share of a piece's points that are such points", high=1)
    leaves: float = parameter(0.1, "Maximum share of leaves in the area of a piece", high=1)


def find_ignored_surface(
    scene: Scene,
    labels: LabelMaps,
    on_surface: Sequence[NDArray[np.bool_]],
    voters: Sequence[int],
    prompts: Prompts,
    leaves: Callable[[int], NDArray[np.bool_]],
    options: IgnoredSurfaceOptions = IgnoredSurfaceOptions(),
) -> list[NDArray[np.bool_]]:
    """Find the ignored pieces of all masks that are the building, bool [H, W] each.

    Args:
        scene: tracks of the sparse points.
        labels: label maps of all views, uint8 [H, W] each.
        on_surface: of each view, which of its observations lie on the building's surface or behind it, bool [N].
        voters: views whose masks are good enough to vote.
        prompts: clicks by view index; a piece with a click beside the building stays ignored, and so does what other
            photos show of it.
        leaves: index of a view -> its pixels that look like leaves, bool [H, W].
        options: fewest photos and points, and most leaves.
    """
    count = len(scene.points)
    ignored, other = np.zeros(count, np.int64), np.zeros(count, np.int64)
    for index in voters:
        here = scene.observations(index)
        held = labels[index][pixel_at(labels[index].shape, scene.track_uv[here])] == IGNORE
        ignored += np.bincount(scene.track_point[here][held], minlength=count)
        other += np.bincount(scene.track_point[here][~held], minlength=count)
    points = (ignored >= options.photos) & (other == 0)
    for index in voters:
        seen = scene.track_point[scene.observations(index)]
        if points[seen].any():
            points[seen[~on_surface[index]]] = False
    for index, clicks in prompts.items():
        piece, here = _pieces(labels[index]), scene.observations(index)
        beside = (piece > 0) & np.isin(piece, piece[pixel_at(piece.shape, clicks.negative)])
        points[scene.track_point[here][beside[pixel_at(piece.shape, scene.track_uv[here])]]] = False
    return [_held(scene, index, label, points, leaves, options) for index, label in enumerate(labels)]


def _held(
    scene: Scene,
    index: int,
    label: NDArray[np.uint8],
    points: NDArray[np.bool_],
    leaves: Callable[[int], NDArray[np.bool_]],
    options: IgnoredSurfaceOptions,
) -> NDArray[np.bool_]:
    """Return the ignored pieces of a mask with enough observations of ``points`` [P] among all, less those with
    ``leaves``, bool [H, W]."""
    own = observed_pixels(scene, index, points)
    if len(own) < options.points:
        return np.zeros(label.shape, bool)
    piece, seen = _pieces(label), scene.track_uv[scene.observations(index)]
    number = int(piece.max()) + 1
    count, every = (np.bincount(piece[pixel_at(label.shape, uv)], minlength=number) for uv in (own, seen))
    held = (count >= options.points) & (count >= options.share * every)
    held[0] = False
    if held.any():
        area = np.bincount(piece.ravel(), minlength=number)
        held &= np.bincount(piece[leaves(index)], minlength=number) <= options.leaves * area
    return np.asarray(held[piece], bool)


def _pieces(label: NDArray[np.uint8]) -> NDArray[np.int32]:
    """Label the connected ignored pieces of a mask from 1 on; 0 elsewhere, [H, W]."""
    return np.asarray(cv2.connectedComponents((label == IGNORE).astype(np.uint8), connectivity=4)[1], np.int32)
