# SPDX-License-Identifier: GPL-3.0-or-later
"""Dense starting points by semi-global matching between neighbouring views inside the masks (``start=dense``).

Plain walls have no sparse points, so Gaussians would have to grow there from elsewhere. Only points that the depth map
of another photo confirms become starting points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.geometry.visual_hull import MaskHullOptions, points_to_match
from mgf_engine.messages import Reporter
from mgf_engine.model.masks import MaskSet, building
from mgf_engine.model.scene import Scene
from mgf_engine.native.parallel import parallel_map
from mgf_engine.options.algorithms import parameter
from mgf_engine.scene.depths import Depths, Matching, match_photos
from mgf_engine.scene.stereo import StereoOptions
from mgf_engine.system.machine import cores


@dataclass(frozen=True)
class DensePointOptions:
    """Options of the dense starting points (``start=dense``)."""

    neighbours: int = parameter(3, "Number of photos that each photo is matched with", low=1)
    longest_side: int = parameter(
        500, "Longest side of the matched photos; more adds points that are averaged anyway", "px", low=16
    )

    stereo: StereoOptions = StereoOptions()
    hull: MaskHullOptions = MaskHullOptions()


def dense_points(
    scene: Scene,
    masks: MaskSet,
    views: Sequence[int],
    limit: int,
    reporter: Reporter,
    threads: int = 0,
    options: DensePointOptions = DensePointOptions(),
) -> tuple[NDArray[np.float64], NDArray[np.uint8], NDArray[np.float64]]:
    """Find points on the building that several views confirm.

    Args:
        scene: photos and cameras.
        masks: the building in each photo.
        views: indices of the views to use.
        limit: approximate maximum number of points, which are averaged in voxels of one size.
        reporter: asked whether to stop.
        threads: number of worker threads; 0 uses all cores.
        options: of the matching.

    Returns:
        points [N, 3] (normalised frame), colors uint8 [N, 3], and a camera centre that sees each, [N, 3].
    """
    threads = threads or cores()
    inside = lambda i: building(masks.labels[i])  # noqa: E731
    matching = Matching(options.neighbours, options.longest_side, options.stereo)
    points_on_building = points_to_match(scene, masks, views, options.hull)
    depths = match_photos(points_on_building, inside, matching, threads, reporter.check)
    confirmed = parallel_map(lambda i: _confirmed_points(i, depths, scene), depths.maps, threads)
    found = [f for f in confirmed if len(f[0])]
    if not found:
        return np.zeros((0, 3)), np.zeros((0, 3), np.uint8), np.zeros((0, 3))
    points, colors, towards = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return _average_in_voxels(points, colors, towards, limit)


def _confirmed_points(
    index: int, depths: Depths, scene: Scene
) -> tuple[NDArray[np.float64], NDArray[np.uint8], NDArray[np.float64]]:
    """Return the points of one view whose depth at least one neighbour confirms, with colours and the view's centre."""
    photo = depths.photos[index]
    pixels, points = depths.points(index, photo.inside)
    height, width = photo.grey.shape
    color = np.asarray(cv2.resize(scene.photo(index), (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    return points, color[tuple(pixels.T)], np.broadcast_to(photo.view.centre, points.shape)


def _average_in_voxels(
    points: NDArray[np.float64], colors: NDArray[np.uint8], towards: NDArray[np.float64], limit: int
) -> tuple[NDArray[np.float64], NDArray[np.uint8], NDArray[np.float64]]:
    """Average points over voxels of the size that leaves about ``limit`` of them, which also reduces noise."""
    local = points - points.min(0)
    size = float(local.max()) / np.sqrt(limit) + 1e-4
    for _ in range(8):
        keys = _voxel_numbers(local, size)
        found = 1 + int(np.count_nonzero(np.diff(np.sort(keys))))
        if found <= limit and (found > 0.85 * limit or found > 0.99 * len(points)):
            break
        # Points lie on surfaces, so the number of voxels goes with the inverse square of their size.
        size *= float(np.sqrt(found / (0.93 * limit)))
    voxel = np.unique(keys, return_inverse=True)[1].reshape(-1)
    count = np.bincount(voxel).astype(np.float64)
    mean = lambda a: np.stack([np.bincount(voxel, weights=a[:, k]) / count for k in range(3)], 1)  # noqa: E731
    first = np.zeros(len(count), np.int64)
    first[voxel[::-1]] = np.arange(len(points))[::-1]
    return mean(points), np.clip(mean(colors.astype(float)), 0, 255).round().astype(np.uint8), towards[first]


def _voxel_numbers(points: NDArray[np.float64], size: float) -> NDArray[np.int64]:
    """Return the number of the voxel that each point lies in."""
    cell = np.floor(points / size).astype(np.int64)
    spans = cell.max(0) + 1
    return np.asarray((cell[:, 0] * spans[1] + cell[:, 1]) * spans[2] + cell[:, 2])
