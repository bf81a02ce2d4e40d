# SPDX-License-Identifier: GPL-3.0-or-later
"""Dense starting points: stereo between neighbouring views inside the masks, kept where views agree.

Sparse points leave blank walls bare; the field would have to grow there from far away. Semi-global matching
between neighbours gives depth in seconds, and only what several pairs say alike becomes a starting point.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.field.neighbours import matching_views, point_sets
from mgf_engine.field.stereo import Photo, pair_depth
from mgf_engine.masks.model import MaskSet, building
from mgf_engine.messages import Reporter
from mgf_engine.scene.model import Scene
from mgf_engine.system import cores
from mgf_engine.threads import in_order

_NEIGHBOURS = 3
_TOLERANCE = 0.008  # relative difference of depth at which two views agree
_LONGEST_SIDE = 500  # px; more costs time and adds points that are thinned out anyway


def dense_points(
    scene: Scene, masks: MaskSet, views: Sequence[int], limit: int, reporter: Reporter, threads: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.uint8], NDArray[np.float64]]:
    """Points on the building that several views agree on.

    Args:
        views: indices of the views to use.
        limit: at most about this many points (thinned by averaging in cubes of one size).

    Returns:
        points [N, 3] (normalised frame), colors uint8 [N, 3], and a camera centre that sees each, [N, 3].
    """
    threads = threads or cores()
    photos = dict(in_order(lambda i: _photo(scene, masks, i), views, threads))
    neighbours = matching_views(scene, masks, views, _NEIGHBOURS)
    pairs = [(i, j) for i in views for j in neighbours[i]]
    sets = point_sets(scene, masks)

    def matched(row: int) -> NDArray[np.float32] | None:
        i, j = pairs[row]
        return pair_depth(photos[i], photos[j], scene.points[np.intersect1d(sets[i], sets[j])])

    depths: dict[int, list[NDArray[np.float32]]] = {i: [] for i in views}
    for row, depth in in_order(matched, range(len(pairs)), threads):
        reporter.check()
        if depth is not None:
            depths[pairs[row][0]].append(depth)
    merged = dict(in_order(lambda i: _merge(depths[i]), [i for i in views if depths[i]], threads))
    agreed = in_order(lambda i: _agreed(i, merged, photos, neighbours, scene), merged, threads)
    found = [f for _, f in agreed if len(f[0])]
    if not found:
        return np.zeros((0, 3)), np.zeros((0, 3), np.uint8), np.zeros((0, 3))
    points, colors, towards = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return _thin(points, colors, towards, limit)


def _photo(scene: Scene, masks: MaskSet, index: int) -> Photo:
    view = scene.views[index]
    factor = min(1.0, _LONGEST_SIDE / max(view.width, view.height))
    size = (max(1, round(view.width * factor)), max(1, round(view.height * factor)))
    grey = np.asarray(cv2.cvtColor(scene.photo(index), cv2.COLOR_RGB2GRAY), np.uint8)
    labels = masks.labels[index]
    if size != (view.width, view.height):
        grey = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)
        labels = np.asarray(cv2.resize(labels, size, interpolation=cv2.INTER_NEAREST), np.uint8)
    sx, sy = size[0] / view.width, size[1] / view.height
    intrinsics = np.array([[view.fx * sx, 0, view.cx * sx], [0, view.fy * sy, view.cy * sy], [0, 0, 1]])
    return Photo(view, grey, building(labels), intrinsics)


def _merge(depths: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    """Median of the depths that agree with it, 0 where pairs contradict each other or only one speaks."""
    stack = np.stack(depths)
    known = stack > 0
    if len(stack) == 1:
        return stack[0]
    rank = np.maximum(known.sum(0) - 1, 0) // 2
    middle = np.take_along_axis(np.sort(np.where(known, stack, np.inf), axis=0), rank[None], axis=0)[0]
    middle = np.where(known.any(0), middle, 0)
    near = known & (np.abs(stack - middle) < 2 * _TOLERANCE * middle)
    votes = near.sum(0)
    mean = (stack * near).sum(0) / np.maximum(votes, 1)
    return np.where((votes >= 1) & (votes * 2 > known.sum(0)), mean, 0).astype(np.float32)


def _agreed(
    index: int,
    merged: dict[int, NDArray[np.float32]],
    photos: dict[int, Photo],
    neighbours: dict[int, list[int]],
    scene: Scene,
) -> tuple[NDArray[np.float64], NDArray[np.uint8], NDArray[np.float64]]:
    """The points of one view whose depth at least one neighbour confirms, with colours and the view's centre."""
    photo, depth = photos[index], merged[index]
    rows, columns = np.nonzero(depth > 0)
    pixels = np.c_[columns + 0.5, rows + 0.5, np.ones(len(rows))]
    local = pixels @ np.linalg.inv(photo.intrinsics).T * depth[rows, columns][:, None]
    points = (local - photo.view.translation) @ photo.view.rotation
    confirmed = np.zeros(len(points), int)
    for other in neighbours[index]:
        if other in merged:
            confirmed += _confirms(points, photos[other], merged[other])
    keep = confirmed >= 1
    height, width = photo.grey.shape
    color = np.asarray(cv2.resize(scene.photo(index), (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    centre = np.broadcast_to(photo.view.centre, points.shape)
    return points[keep], color[rows[keep], columns[keep]], centre[keep]


def _confirms(points: NDArray[np.float64], photo: Photo, depth: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Whether a view's depth says the same as the points, [N]."""
    local = points @ photo.view.rotation.T + photo.view.translation
    z = local[:, 2]
    uv = local @ photo.intrinsics.T / np.maximum(z, 1e-9)[:, None]
    column, row = np.floor(uv[:, 0]), np.floor(uv[:, 1])
    height, width = depth.shape
    inside = (z > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    seen = np.zeros(len(points), np.float64)
    seen[inside] = depth[row[inside].astype(int), column[inside].astype(int)]
    return (seen > 0) & (np.abs(seen - z) < _TOLERANCE * z)


def _thin(
    points: NDArray[np.float64], colors: NDArray[np.uint8], towards: NDArray[np.float64], limit: int
) -> tuple[NDArray[np.float64], NDArray[np.uint8], NDArray[np.float64]]:
    """Means over cubes of the size that leaves about ``limit`` points; averaging also calms the noise."""
    local = points - points.min(0)
    size = float(local.max()) / np.sqrt(limit) + 1e-4
    for _ in range(8):
        cubes = _cubes(local, size)
        found = int(cubes.max()) + 1
        if found <= limit and (found > 0.85 * limit or found > 0.99 * len(points)):
            break
        # Points lie on surfaces, so the number of cubes goes with the inverse square of their size.
        size *= float(np.sqrt(found / (0.93 * limit)))
    count = np.bincount(cubes).astype(np.float64)
    mean = lambda a: np.stack([np.bincount(cubes, weights=a[:, k]) / count for k in range(3)], 1)  # noqa: E731
    first = np.zeros(len(count), np.int64)
    first[cubes[::-1]] = np.arange(len(points))[::-1]
    return mean(points), np.clip(mean(colors.astype(float)), 0, 255).round().astype(np.uint8), towards[first]


def _cubes(points: NDArray[np.float64], size: float) -> NDArray[np.int64]:
    """Consecutive number of the cube each point lies in."""
    cell = np.floor(points / size).astype(np.int64)
    spans = cell.max(0) + 1
    key = (cell[:, 0] * spans[1] + cell[:, 1]) * spans[2] + cell[:, 2]
    return np.unique(key, return_inverse=True)[1].reshape(-1)
