# SPDX-License-Identifier: GPL-3.0-or-later
"""Choose the photos that are used, those suggested for clicks, and those held out of training."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.sampling import farthest_point_sampling
from mgf_engine.model.scene import View
from mgf_engine.scene.normalise import CAMERA_DISTANCE

_FEWEST_ROOTS = 3
_FEWEST_TRAINED = 3


def camera_poses(
    views: Sequence[View], track_view: NDArray[np.int32]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Return the centre [V, 3], viewing direction [V, 3] and number of observed points [V] of each view.

    Args:
        track_view: [T], the view of each observation.
    """
    centres = np.array([view.centre for view in views])
    directions = np.array([view.rotation[2] for view in views])
    return centres, directions, np.bincount(track_view, minlength=len(views))


def choose_roots(
    centres: NDArray[np.float64], directions: NDArray[np.float64], seen: NDArray[np.int64]
) -> tuple[int, ...]:
    """Choose a fifth of the views (at least 3, or all), see :func:`sample_views`.

    Returns:
        Sorted indices of the roots.
    """
    count = min(len(centres), max(_FEWEST_ROOTS, math.ceil(len(centres) / 5)))
    return tuple(sorted(sample_views(centres, directions, seen, count)))


def sample_views(
    centres: NDArray[np.float64],
    directions: NDArray[np.float64],
    seen: NDArray[np.int64],
    count: int,
    wanted: Collection[int] = (),
) -> list[int]:
    """Choose views by farthest-point sampling; a smaller ``count`` gives the first ones of a larger.

    Two views are far apart when they stand apart or look in different directions. The first view is the one with the
    most observed points, ties go to the lower index, so the choice depends on the scene alone.

    Args:
        centres: [V, 3] camera centres, normalised frame.
        directions: [V, 3] unit viewing directions.
        seen: [V] number of points observed by each view.
        count: number of views.
        wanted: views that are taken in any case, however many.
    """
    feature = np.concatenate([centres / CAMERA_DISTANCE, directions], 1)
    return farthest_point_sampling(feature, count, sorted(wanted) or [int(np.argmax(seen))])


def choose_held_out(count: int, roots: tuple[int, ...], every: int) -> tuple[int, ...]:
    """Choose every n-th view in the order of names, spread evenly, roots avoided while other views are left.

    Args:
        count: number of views.
        roots: indices of the root views.
        every: n; 0 keeps none out. Three views at least stay in training.

    Returns:
        Sorted indices of the views kept out.
    """
    if every <= 0:
        return ()
    wanted = max(0, min(math.ceil(count / every), count - _FEWEST_TRAINED))
    free = set(range(count)) - set(roots)
    chosen: list[int] = []
    for k in range(wanted):
        if not free:
            free = set(roots)
        chosen.append(_nearest((k + 0.5) * count / wanted - 0.5, free, count))
        free.remove(chosen[-1])
    return tuple(sorted(chosen))


def _nearest(place: float, free: set[int], count: int) -> int:
    """Return the member of ``free``, in 0..count - 1, that is nearest to a place; the smaller one of two."""
    low = math.floor(place)
    high = low + 1
    while low >= 0 or high < count:
        if place - low <= high - place:
            low, found = low - 1, low
        else:
            high, found = high + 1, high
        if found in free:
            return found
    raise ValueError("nothing is free")
