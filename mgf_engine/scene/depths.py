# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth of photos from their neighbours: where structure from motion found no point, flat walls and roofs still match.

Each photo is matched with a few neighbours (``stereo.py``); what its pairs say alike is its depth, and what another
photo's depth confirms is a point of the scene.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.model.scene import Scene
from mgf_engine.native.parallel import parallel_map
from mgf_engine.scene.neighbours import matching_views, point_sets
from mgf_engine.scene.stereo import Photo, pair_depth

TOLERANCE = 0.008  # relative difference of depth at which two views agree


@dataclass(frozen=True)
class Depths:
    """Depths of some views.

    Attributes:
        photos: by view, at the resolution they were matched at.
        neighbours: by view, those it was matched with.
        maps: by view, float32 [h, w], its own z in normalised units, 0 where unknown; none of views that no pair fits.
    """

    photos: dict[int, Photo]
    neighbours: dict[int, list[int]]
    maps: dict[int, NDArray[np.float32]]

    def points(self, index: int, wanted: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """The wanted pixels [h, w] of a view that a neighbour confirms: (row, column) [N, 2], points [N, 3]."""
        photo, depth = self.photos[index], self.maps[index]
        rows, columns = np.nonzero((depth > 0) & wanted)
        pixels = np.c_[columns + 0.5, rows + 0.5, np.ones(len(rows))]
        local = pixels @ np.linalg.inv(photo.intrinsics).T * depth[rows, columns][:, None]
        points = (local - photo.view.translation) @ photo.view.rotation
        keep = np.zeros(len(points), bool)
        for other in self.neighbours[index]:
            keep |= self.confirms(other, points)
        return np.stack([rows, columns], 1)[keep], points[keep]

    def confirms(self, index: int, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell whether a view's depth confirms points [N, 3], bool [N]."""
        if index not in self.maps:
            return np.zeros(len(points), bool)
        view = self.photos[index].view
        z = points @ view.rotation[2] + view.translation[2]
        seen = self.depth_at(index, points)
        return (seen > 0) & (np.abs(seen - z) < TOLERANCE * z)

    def depth_at(self, index: int, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Depth of a view that has a map where points [N, 3] project, 0 where it is unknown, [N]."""
        photo, depth = self.photos[index], self.maps[index]
        local = points @ photo.view.rotation.T + photo.view.translation
        z = local[:, 2]
        uv = local @ photo.intrinsics.T / np.maximum(z, 1e-9)[:, None]
        column, row = np.floor(uv[:, 0]), np.floor(uv[:, 1])
        height, width = depth.shape
        inside = (z > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        seen = np.zeros(len(points), np.float64)
        seen[inside] = depth[row[inside].astype(int), column[inside].astype(int)]
        return seen


def match_photos(
    scene: Scene,
    views: Sequence[int],
    kept: NDArray[np.bool_],
    inside: Callable[[int], NDArray[np.bool_]] | None,
    neighbours: int,
    longest_side: int,
    threads: int,
    check: Callable[[], None],
) -> Depths:
    """Depths of ``views`` from each other.

    Args:
        kept: [P], sparse points that tell which views are neighbours and how far away things are.
        inside: view -> bool [H, W], the pixels that are wanted; None for all.
        neighbours: how many others each view is matched with.
        longest_side: px; larger photos are reduced for matching.
        check: called between pairs; may raise to cancel.
    """
    read = parallel_map(lambda i: photo_at(scene, i, inside and inside(i), longest_side), views, threads)
    photos = dict(zip(views, read, strict=True))
    chosen = matching_views(scene, kept, views, neighbours)
    pairs = [(i, j) for i in views for j in chosen[i]]
    sets = point_sets(scene, kept)

    def matched(row: int) -> NDArray[np.float32] | None:
        i, j = pairs[row]
        return pair_depth(photos[i], photos[j], scene.points[np.intersect1d(sets[i], sets[j])])

    found: dict[int, list[NDArray[np.float32]]] = {i: [] for i in views}
    for row, depth in enumerate(parallel_map(matched, range(len(pairs)), threads)):
        check()
        if depth is not None:
            found[pairs[row][0]].append(depth)
    matched_views = [i for i in views if found[i]]
    merged = parallel_map(lambda i: _merge(found[i]), matched_views, threads)
    maps = dict(zip(matched_views, merged, strict=True))
    return Depths(photos, chosen, maps)


def photo_at(scene: Scene, index: int, inside: NDArray[np.bool_] | None, longest_side: int) -> Photo:
    """The photo of a view reduced to ``longest_side``, with the pixels that are wanted [H, W]; None for all."""
    view = scene.views[index]
    factor = min(1.0, longest_side / max(view.width, view.height))
    size = (max(1, round(view.width * factor)), max(1, round(view.height * factor)))
    grey = np.asarray(cv2.cvtColor(scene.photo(index), cv2.COLOR_RGB2GRAY), np.uint8)
    wanted = np.ones(grey.shape, np.uint8) if inside is None else inside.astype(np.uint8)
    if size != (view.width, view.height):
        grey = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)
        wanted = np.asarray(cv2.resize(wanted, size, interpolation=cv2.INTER_NEAREST), np.uint8)
    sx, sy = size[0] / view.width, size[1] / view.height
    intrinsics = np.array([[view.fx * sx, 0, view.cx * sx], [0, view.fy * sy, view.cy * sy], [0, 0, 1]])
    return Photo(view, grey, wanted > 0, intrinsics)


def _merge(depths: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    """Median of the depths that agree with it, 0 where pairs contradict each other or none speaks."""
    stack = np.stack(depths)
    known = stack > 0
    if len(stack) == 1:
        return stack[0]
    rank = np.maximum(known.sum(0) - 1, 0) // 2
    middle = np.take_along_axis(np.sort(np.where(known, stack, np.inf), axis=0), rank[None], axis=0)[0]
    middle = np.where(known.any(0), middle, 0)
    near = known & (np.abs(stack - middle) < 2 * TOLERANCE * middle)
    votes = near.sum(0)
    mean = (stack * near).sum(0) / np.maximum(votes, 1)
    return np.where((votes >= 1) & (votes * 2 > known.sum(0)), mean, 0).astype(np.float32)
