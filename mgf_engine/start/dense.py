# SPDX-License-Identifier: GPL-3.0-or-later
"""Dense points by stereo where photos have texture and others confirm them, with the views that saw them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.geometry.visual_hull import with_hull_points
from mgf_engine.model.masks import MaskSet, building
from mgf_engine.native.parallel import parallel_map
from mgf_engine.scene.depths import Depths, match_photos
from mgf_engine.start.options import DenseOptions
from mgf_engine.start.views import StartViews

_FAR = 50.0  # degrees: photos further around confirm nothing
_PER_CUBE = 2  # points at least in a cube


def dense_points(
    views: StartViews, masks: MaskSet, o: DenseOptions, threads: int, check: Callable[[], None]
) -> tuple[NDArray[np.float64], list[NDArray[np.int64]]]:
    """Points [N, 3], one per cube of ``o.size`` px, and positions of the views that saw each."""
    scene, kept = with_hull_points(views.scene, masks, views.indices)
    inside = lambda i: building(masks.labels[i])  # noqa: E731
    depths = match_photos(scene, views.indices, kept, inside, o.neighbours, o.longest_side, threads, check)
    numbers = [n for n, i in enumerate(views.indices) if i in depths.maps]
    found = list(parallel_map(lambda n: _confirmed(views, depths, n, o), numbers, threads))
    if not any(len(points) for points, _ in found):
        return np.zeros((0, 3)), []
    points, seen = (np.concatenate(part) for part in zip(*found, strict=True))
    return _thin(points, seen, o.size * views.pixel)


def _confirmed(
    views: StartViews, depths: Depths, number: int, o: DenseOptions
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Points [N, 3] of one photo and which views saw them, bool [N, V]."""
    photo = depths.photos[views.indices[number]]
    height, width = photo.grey.shape
    color = cv2.resize(views.scene.photo(views.indices[number]), (width, height), interpolation=cv2.INTER_AREA)
    light = cv2.cvtColor(color.astype(np.float32) / 255, cv2.COLOR_RGB2Lab)[..., 0]
    _, points = depths.points(views.indices[number], photo.inside & (_texture(light) > o.texture))
    points = points[((points > views.low) & (points < views.high)).all(1)]
    seen = np.zeros((len(points), len(views.views)), bool)
    for other in np.flatnonzero(views.angles[number] < _FAR):
        seen[:, other] = depths.confirms(views.indices[other], points)
    seen[:, number] = True
    keep = seen.sum(1) > o.confirmed_by
    return points[keep], seen[keep]


def _texture(light: NDArray[Any]) -> NDArray[np.float32]:
    """Root mean square of the gradient in the direction in which it is least, per px within 7 x 7 px, [H, W].

    The smaller eigenvalue of the structure tensor (Shi and Tomasi 1994): along a straight edge nothing tells how far
    away it is, and edges have points of their own.
    """
    # OpenCV's tensor is of Sobel differences over a length of two pixels.
    least = np.maximum(cv2.cornerMinEigenVal(light, 7, ksize=3), 0)
    return np.asarray(np.sqrt(least) / 2, np.float32)


def _thin(
    points: NDArray[np.float64], seen: NDArray[np.bool_], size: float
) -> tuple[NDArray[np.float64], list[NDArray[np.int64]]]:
    """Means over cubes that hold enough points, and the views that saw nearly half of them."""
    if not len(points):
        return points, []
    cell = np.floor((points - points.min(0)) / size).astype(np.int64)
    spans = cell.max(0) + 1
    key = (cell[:, 0] * spans[1] + cell[:, 1]) * spans[2] + cell[:, 2]
    order = np.argsort(key, kind="stable")
    start = np.flatnonzero(np.diff(key[order], prepend=-1))
    count = np.diff(np.r_[start, len(key)])
    mean = np.add.reduceat(points[order], start) / count[:, None]
    share = np.add.reduceat(seen[order].astype(np.float32), start) / count[:, None]
    keep = (count >= _PER_CUBE) & (share.max(1) > 0.4)
    rows, number = np.nonzero(share[keep] > 0.4)
    return mean[keep], np.split(number, np.searchsorted(rows, np.arange(1, keep.sum())))
