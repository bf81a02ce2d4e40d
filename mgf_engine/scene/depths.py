# SPDX-License-Identifier: GPL-3.0-or-later
"""Compute depth maps of photos: flat walls and roofs match even where structure from motion found no point.

Each photo is matched with a few neighbours (``stereo.py``), and the depths on which its pairs agree are averaged. A
pixel whose depth another photo's depth map confirms is a point of the scene.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.model.scene import Scene
from mgf_engine.native.parallel import parallel_map
from mgf_engine.scene.neighbours import MatchingPoints
from mgf_engine.scene.stereo import StereoOptions, StereoPhoto, pair_depth


@dataclass(frozen=True)
class Matching:
    """How photos are matched.

    Attributes:
        neighbours: number of others that each photo is matched with.
        longest_side: px; larger photos are reduced.
        stereo: options of the choice of neighbours and of each pair.
        blur: standard deviation by which the reduced photos are blurred, px; 0 for not at all.
    """

    neighbours: int
    longest_side: int
    stereo: StereoOptions = StereoOptions()
    blur: float = 0.0


@dataclass(frozen=True)
class Depths:
    """Depth maps of some views.

    Attributes:
        photos: by view, at the resolution they were matched at.
        neighbours: by view, those it was matched with.
        maps: by view, float32 [h, w], its own z in normalised units, 0 where unknown; none of views that no pair fits.
        tolerance: difference up to which two depths agree, as a share of the depth.
    """

    photos: dict[int, StereoPhoto]
    neighbours: dict[int, list[int]]
    maps: dict[int, NDArray[np.float32]]
    tolerance: float

    def points(self, index: int, wanted: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Find the points of a view that a neighbour confirms.

        Args:
            index: the view.
            wanted: the pixels to look at, bool [h, w].

        Returns:
            (row, column) of the pixels [N, 2], and points [N, 3] in the normalised frame.
        """
        photo, depth = self.photos[index], self.maps[index]
        rows, columns = np.nonzero((depth > 0) & wanted)
        pixels = np.c_[columns + 0.5, rows + 0.5, np.ones(len(rows))]
        local = pixels @ np.linalg.inv(photo.view.intrinsics).T * depth[rows, columns][:, None]
        points = (local - photo.view.translation) @ photo.view.rotation
        keep = np.zeros(len(points), bool)
        for other in self.neighbours[index]:
            keep |= self.confirms(other, points)
        return np.stack([rows, columns], 1)[keep], points[keep]

    def confirms(self, index: int, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell whether a view's depth map agrees with the depth of points [N, 3], bool [N]."""
        z, seen = self._compare(index, points)
        return (seen > 0) & (np.abs(seen - z) < self.tolerance * z)

    def hides(self, index: int, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell whether a view's depth map occludes points [N, 3] by more than twice the tolerance, bool [N]."""
        z, seen = self._compare(index, points)
        return (seen > 0) & (z - seen > 2 * self.tolerance * z)

    def _compare(self, index: int, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the depth of points [N, 3] in a view and that of its map where they project, 0 for unknown, [N]."""
        uv, z, inside = self.photos[index].view.project_into_frame(points)
        seen = np.zeros(len(points))
        if index in self.maps:
            column, row = uv[inside].astype(np.int64).T
            seen[inside] = self.maps[index][row, column]
        return z, seen


def match_photos(
    points: MatchingPoints,
    inside: Callable[[int], NDArray[np.bool_]] | None,
    matching: Matching,
    threads: int,
    check: Callable[[], None],
) -> Depths:
    """Compute the depth maps of views from each other.

    Args:
        points: photos and cameras, and the sparse points that choose neighbours and the range of depths.
        inside: view -> bool [H, W], the pixels that are wanted; None for all.
        matching: options of the matching.
        threads: number of worker threads.
        check: called between photos; may raise to cancel.
    """
    scene, views = points.scene, points.views

    def read_photo(i: int) -> StereoPhoto:
        photo = photo_at(scene, i, inside and inside(i), matching.longest_side)
        if matching.blur <= 0:
            return photo
        return replace(photo, grey=np.asarray(cv2.GaussianBlur(photo.grey, (0, 0), matching.blur), np.uint8))

    read = parallel_map(read_photo, views, threads)
    photos = dict(zip(views, read, strict=True))
    chosen = points.neighbours(matching.neighbours, matching.stereo.neighbours)
    observed, tolerance = points.observed, matching.stereo.tolerance

    def match_view(i: int) -> NDArray[np.float32] | None:
        found = []
        for j in chosen[i]:
            shared = scene.points[np.intersect1d(observed[i], observed[j])]
            depth = pair_depth(photos[i], photos[j], shared, matching.stereo)
            if depth is not None:
                found.append(depth)
        return _merge(found, 2 * tolerance) if found else None

    maps = {}
    for i, depth in zip(views, parallel_map(match_view, views, threads), strict=True):
        check()
        if depth is not None:
            maps[i] = depth
    return Depths(photos, chosen, maps, tolerance)


def photo_at(scene: Scene, index: int, inside: NDArray[np.bool_] | None, longest_side: int) -> StereoPhoto:
    """Read the photo of a view for stereo.

    Args:
        scene: photos and cameras.
        index: the view.
        inside: pixels whose depth is wanted, bool [H, W]; None for all.
        longest_side: px; a larger photo is reduced.
    """
    view = scene.views[index]
    factor = min(1.0, longest_side / max(view.width, view.height))
    size = (max(1, round(view.width * factor)), max(1, round(view.height * factor)))
    grey = np.asarray(cv2.cvtColor(scene.photo(index), cv2.COLOR_RGB2GRAY), np.uint8)
    wanted = np.ones(grey.shape, np.uint8) if inside is None else inside.astype(np.uint8)
    if size != (view.width, view.height):
        grey = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)
        wanted = np.asarray(cv2.resize(wanted, size, interpolation=cv2.INTER_NEAREST), np.uint8)
    return StereoPhoto(view.resized(*size), grey, wanted > 0)


def _merge(depths: list[NDArray[np.float32]], tolerance: float) -> NDArray[np.float32]:
    """Average the depths [h, w] of a photo's pairs that agree with their median; 0 where at most half of them do."""
    stack = np.stack(depths)
    known = stack > 0
    if len(stack) == 1:
        return stack[0]
    rank = np.maximum(known.sum(0) - 1, 0) // 2
    middle = np.take_along_axis(np.sort(np.where(known, stack, np.inf), axis=0), rank[None], axis=0)[0]
    middle = np.where(known.any(0), middle, 0)
    near = known & (np.abs(stack - middle) < tolerance * middle)
    votes = near.sum(0)
    mean = (stack * near).sum(0) / np.maximum(votes, 1)
    return np.where((votes >= 1) & (votes * 2 > known.sum(0)), mean, 0).astype(np.float32)
