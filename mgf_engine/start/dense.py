# SPDX-License-Identifier: GPL-3.0-or-later
"""Find dense points by stereo where photos have texture and others confirm them, with the views that saw them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

from mgf_engine.masks.geometry.visual_hull import with_hull_points
from mgf_engine.masks.image_ops import rgb_to_lab
from mgf_engine.model.masks import MaskSet, building
from mgf_engine.native.parallel import parallel_map
from mgf_engine.scene.coarse_stereo import confirmed_texture, match_reduced, texture_strength
from mgf_engine.scene.depths import Depths, Matching, match_photos
from mgf_engine.scene.patch_match import improve_depths
from mgf_engine.start.confirmation import confirmed_share, surface_normals
from mgf_engine.start.options import DenseOptions, PointSmoothingOptions
from mgf_engine.start.smoothing import smooth_points
from mgf_engine.start.views import StartViews

log = logging.getLogger("mgf")
_BATCH = 8  # photos whose points are added up together


def find_stereo_points(
    views: StartViews,
    masks: MaskSet,
    options: DenseOptions,
    smoothing: PointSmoothingOptions,
    threads: int,
    check: Callable[[], None],
) -> DensePoints:
    """Match the photos: one point per voxel of ``options.size`` px that enough of the photos confirm, smoothed.

    Where hardly any texture is confirmed, it is finer than the photos can show: reduced photos are matched, too.

    Args:
        views: cameras and masks at working size.
        masks: the building in each photo.
        options: matching, voxels and confirmation.
        smoothing: of the points.
        threads: number of worker threads.
        check: called between photos; may raise to cancel.
    """
    points = with_hull_points(views.scene, masks, views.indices, options.hull)
    matching = Matching(options.neighbours, options.longest_side, options.stereo)

    def inside(index: int) -> NDArray[np.bool_]:
        return building(masks.labels[index])

    depths = match_photos(points, inside, matching, threads, check)
    aliased = confirmed_texture(depths, options.coarse) < options.coarse.least_confirmed
    depths = improve_depths(depths, points, options.stereo.neighbours, options.patch_match, check)
    found = _fuse(views, depths, options, views.pixel, smoothing, threads)
    if not aliased:
        return found
    log.info("start: fine texture aliases, reduced photos are matched")
    depths = match_reduced(points, inside, matching, options.coarse, threads, check)
    a, factor = options.aliased, options.coarse.factor
    coarse = replace(
        options, texture=a.texture, confirmed_by=a.confirmed_by, least_share=a.least_share, weight=a.weight
    )
    return replace(found.joined(_fuse(views, depths, coarse, factor * views.pixel, smoothing, threads)), aliased=True)


def _fuse(
    views: StartViews,
    depths: Depths,
    options: DenseOptions,
    pixel: float,
    smoothing: PointSmoothingOptions,
    threads: int,
) -> DensePoints:
    """Fuse depth maps to points.

    Args:
        views: cameras and masks.
        depths: the depth maps.
        options: voxels and confirmation.
        pixel: size of a pixel of the matched photos at the building.
        smoothing: of the points.
        threads: number of worker threads.
    """
    numbers = [n for n, i in enumerate(views.indices) if i in depths.maps]
    size = options.size * pixel
    parts = [VoxelSums.of(np.zeros((0, 3)), csr_array((0, len(views.views)), dtype=np.uint32), views.low, size)]
    for sums in parallel_map(
        lambda n: VoxelSums.of(*_confirmed(views, depths, n, options), views.low, size), numbers, threads
    ):
        parts.append(sums)
        if len(parts) > _BATCH:
            parts = [VoxelSums.joined(parts)]
    points, seen = VoxelSums.joined(parts).means(options.least_points, options.seen_share)
    normals = surface_normals(points, options.normal_neighbours, threads)
    share = confirmed_share(views, depths, points, normals, seen, options)
    enough = np.flatnonzero(share >= options.least_share)
    weight = options.weight * np.minimum(share[enough] / options.full_share, 1) ** 2
    smooth, normals = smooth_points(points[enough], normals[enough], pixel, smoothing, threads)
    confirmed = DensePoints(smooth, [seen[n] for n in enough], weight, normals)
    return _towards_views(confirmed, views.centres)


def _towards_views(dense: DensePoints, centres: NDArray[np.float64]) -> DensePoints:
    """Orient the normals towards the mean centre of the views that see each point."""
    if not len(dense.points):
        return dense
    count = np.array([len(s) for s in dense.seen])
    middle = np.add.reduceat(centres[np.concatenate(dense.seen)], np.cumsum(count) - count) / count[:, None]
    away = ((middle - dense.points) * dense.normals).sum(1) < 0
    return replace(dense, normals=np.where(away[:, None], -dense.normals, dense.normals))


def _confirmed(
    views: StartViews, depths: Depths, number: int, options: DenseOptions
) -> tuple[NDArray[np.float64], csr_array]:
    """Return the points [N, 3] of one photo that others confirm, and which views saw them, ones in [N, V]."""
    photo = depths.photos[views.indices[number]]
    height, width = photo.grey.shape
    color = cv2.resize(views.scene.photo(views.indices[number]), (width, height), interpolation=cv2.INTER_AREA)
    light = rgb_to_lab(np.asarray(color, np.uint8))[..., 0]
    _, points = depths.points(views.indices[number], photo.inside & (texture_strength(light) > options.texture))
    points = points[((points > views.low) & (points < views.high)).all(1)]
    others = [int(n) for n in np.flatnonzero(views.angles[number] < options.largest_angle) if n != number]
    rows = [np.arange(len(points)), *(np.flatnonzero(depths.confirms(views.indices[n], points)) for n in others)]
    view = np.repeat([number, *others], [len(part) for part in rows])
    row = np.concatenate(rows)
    seen = csr_array((np.ones(len(row), np.uint32), (row, view)), shape=(len(points), len(views.views)))
    keep = np.bincount(row, minlength=len(points)) > options.confirmed_by
    return points[keep], seen[keep]


@dataclass(frozen=True)
class DensePoints:
    """Points by stereo.

    Attributes:
        points: [N, 3], normalised frame.
        seen: of each, positions of the views that see it.
        weight: of each one's rays, [N].
        normals: unit vectors towards the views, [N, 3].
        aliased: whether the texture aliases: it is finer than the photos resolve.
    """

    points: NDArray[np.float64]
    seen: list[NDArray[np.int64]]
    weight: NDArray[np.float64]
    normals: NDArray[np.float64]
    aliased: bool = False

    def joined(self, other: DensePoints) -> DensePoints:
        """Return these points and other ones."""
        points, weight, normals = (
            np.concatenate([getattr(part, name) for part in (self, other)]) for name in ("points", "weight", "normals")
        )
        return DensePoints(points, [*self.seen, *other.seen], weight, normals, self.aliased)


@dataclass(frozen=True)
class VoxelSums:
    """Sums of points per voxel of a grid, so that the points of all photos are never in memory together.

    Attributes:
        key: index of each voxel in the grid, ascending, int64 [C, 3].
        total: sum of its points, [C, 3].
        count: number of its points, [C].
        votes: how many of them each view saw, uint32 [C, V]; most saw none, so it is sparse.
    """

    key: NDArray[np.int64]
    total: NDArray[np.float64]
    count: NDArray[np.int64]
    votes: csr_array

    @classmethod
    def of(cls, points: NDArray[np.float64], seen: csr_array, low: NDArray[np.float64], size: float) -> VoxelSums:
        """Add up points in voxels.

        Args:
            points: [N, 3].
            seen: ones where a view saw a point, uint32 [N, V].
            low: corner of the grid, [3].
            size: of a voxel.
        """
        key = np.floor((points - low) / size).astype(np.int64)
        return cls(key, points, np.ones(len(points), np.int64), seen)._summed()

    @classmethod
    def joined(cls, parts: Sequence[VoxelSums]) -> VoxelSums:
        """Add up voxels of one grid."""
        key, total, count = (np.concatenate([getattr(p, name) for p in parts]) for name in ("key", "total", "count"))
        return cls(key, total, count, vstack([part.votes for part in parts], format="csr"))._summed()

    def _summed(self) -> VoxelSums:
        """Add up the entries of each voxel."""
        order = np.lexsort(self.key.T)
        key = self.key[order]
        start = np.flatnonzero(np.r_[True, (np.diff(key, axis=0) != 0).any(1)][: len(key)])
        if not len(start):
            return self
        total, count = (np.add.reduceat(values[order], start) for values in (self.total, self.count))
        members = csr_array((np.ones(len(key), np.uint32), order, np.r_[start, len(key)]), (len(start), len(key)))
        return VoxelSums(key[start], total, count, members @ self.votes)

    def means(self, least: int, seen_share: float) -> tuple[NDArray[np.float64], list[NDArray[np.int64]]]:
        """Return the mean points [N, 3] of voxels with at least ``least`` points, and the views that saw each.

        A view saw a mean point if it saw more than ``seen_share`` of the voxel's points.
        """
        votes = self.votes.sorted_indices()
        row = np.repeat(np.arange(len(self.count)), np.diff(votes.indptr))
        enough = (votes.data > seen_share * self.count[row]) & (self.count[row] >= least)
        kept, first = np.unique(row[enough], return_index=True)
        mean = self.total[kept] / self.count[kept, None]
        return mean, np.split(votes.indices[enough].astype(np.int64), first[1:]) if len(kept) else []
