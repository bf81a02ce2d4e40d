# SPDX-License-Identifier: GPL-3.0-or-later
"""Prepare photos, cameras and masks of one building for the starting surface, at its working size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.geometry.boxes import grid_points, pad_box, percentile_box
from mgf_engine.geometry.rasterize import scaled_view
from mgf_engine.masks.geometry.visual_hull import hull_cells
from mgf_engine.model.masks import BACKGROUND, MaskSet, building
from mgf_engine.model.pixels import pixel_at
from mgf_engine.model.scene import Scene, View
from mgf_engine.native.library import parallel
from mgf_engine.start.options import OutsideOptions, ViewOptions


@dataclass(frozen=True)
class StartViews:
    """The ``V`` views that a starting surface is made from, in the normalised frame.

    Attributes:
        indices: their numbers in the scene.
        views: the cameras at working size.
        labels: uint8 [H, W] each.
        silhouettes: their masks, as :func:`find_outside` takes them.
        points, seen: sparse points on the building [N, 3], and of each the positions of the views that saw it.
        pixel: size of a pixel at the building.
        low, high: the box that holds it, [3] each.
        cells: centres of the cells of its coarse visual hull [C, 3].
    """

    scene: Scene
    indices: list[int]
    views: list[View]
    labels: list[NDArray[np.uint8]]
    silhouettes: Silhouettes
    points: NDArray[np.float64]
    seen: list[NDArray[np.int64]]
    pixel: float
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    cells: NDArray[np.float64]

    @cached_property
    def centres(self) -> NDArray[np.float64]:
        """Camera centres [V, 3]."""
        return np.stack([view.centre for view in self.views])

    @cached_property
    def pixels_to_rays(self) -> NDArray[np.float64]:
        """Matrices that take homogeneous pixels to directions in the normalised frame, [V, 3, 3]."""
        return np.asarray(np.linalg.inv(self.silhouettes.projections[:, :, :3]), np.float64)

    @cached_property
    def angles(self) -> NDArray[np.float64]:
        """Angles between the views as the middle of the building sees them, degrees [V, V]."""
        away = self.centres - (self.low + self.high) / 2
        away = away / np.linalg.norm(away, axis=1, keepdims=True)
        return np.asarray(np.degrees(np.arccos(np.clip(away @ away.T, -1, 1))))

    def photo(self, number: int) -> NDArray[np.uint8]:
        """Read a photo at working size, RGB, uint8 [H, W, 3]."""
        view, photo = self.views[number], self.scene.photo(self.indices[number])
        if photo.shape[:2] == (view.height, view.width):
            return photo
        return np.asarray(cv2.resize(photo, (view.width, view.height), interpolation=cv2.INTER_AREA), np.uint8)

    def is_outside(self, points: NDArray[np.float64], options: OutsideOptions) -> NDArray[np.bool_]:
        """Find the points [N, 3] outside of the visual hull, bool [N]; see :func:`find_outside`."""
        return find_outside(points, self.silhouettes, options)


@dataclass(frozen=True)
class Silhouettes:
    """Masks of ``V`` views, by which points are inside or outside of the visual hull.

    Attributes:
        projections: matrices that take points in the normalised frame to pixels, [V, 3, 4].
        outside: distances outside of the masks in eighths of a pixel, 255 for more, uint8 [V, H, W]; of smaller photos
            the rest is 0.
        sizes: width and height of each photo, int32 [V, 2]; 0 for those whose masks are not used.
    """

    projections: NDArray[np.float64]
    outside: NDArray[np.uint8]
    sizes: NDArray[np.int32]

    @classmethod
    def of(cls, views: Sequence[View], labels: Sequence[NDArray[np.uint8]]) -> Silhouettes:
        """Prepare label maps [H, W] of views; ignored pixels are not outside."""
        sizes = np.array([(view.width, view.height) for view in views], np.int32)
        width, height = sizes.max(0)
        outside = np.zeros((len(labels), height, width), np.uint8)
        for out, label in zip(outside, labels, strict=True):
            distance = cv2.distanceTransform((label == BACKGROUND).astype(np.uint8), cv2.DIST_L2, 5)
            out[: label.shape[0], : label.shape[1]] = np.minimum(8 * distance, 255)
        return cls(np.ascontiguousarray(np.stack([projection(view) for view in views])), outside, sizes)

    def only(self, number: int) -> Silhouettes:
        """Return the silhouette of one view."""
        part = slice(number, number + 1)
        return Silhouettes(self.projections[part], self.outside[part], self.sizes[part])

    def without(self, numbers: Sequence[int]) -> Silhouettes:
        """Return them without the masks of some views."""
        sizes = self.sizes.copy()
        sizes[list(numbers)] = 0
        return replace(self, sizes=sizes)


def projection(view: View) -> NDArray[np.float64]:
    """Return the matrix [3, 4] that takes points in the normalised frame to pixels."""
    return np.asarray(view.intrinsics @ np.c_[view.rotation, view.translation])


def pixel_rays(views: StartViews, number: NDArray[np.integer], uv: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return unit directions [N, 3] in the normalised frame of pixels [N, 2] of views ``number`` [N]."""
    rays = np.einsum("nij,nj->ni", views.pixels_to_rays[number], np.c_[uv, np.ones(len(uv))])
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def find_outside(points: NDArray[np.float64], silhouettes: Silhouettes, options: OutsideOptions) -> NDArray[np.bool_]:
    """Find the points that lie outside of the visual hull (kernel ``mgf_find_outside``).

    Args:
        points: [N, 3], normalised frame.
        silhouettes: the masks.
        options: how many of them call a point outside.

    Returns:
        bool [N].
    """
    result = np.zeros(len(points), np.uint8)
    points, (views, height, width) = np.ascontiguousarray(points, dtype=np.float64), silhouettes.outside.shape
    parallel(
        "mgf_find_outside", len(points), points, silhouettes.projections, views, silhouettes.outside, height, width,
        silhouettes.sizes, float(options.margin), options.least_views, float(options.share), result,
    )  # fmt: skip
    return result > 0


def start_views(scene: Scene, masks: MaskSet, indices: Sequence[int], options: ViewOptions) -> StartViews:
    """Prepare views of a scene for the starting surface.

    Args:
        scene: photos, cameras and sparse points.
        masks: the building in each photo.
        indices: the views.
        options: working size, and which points and masks count.

    Raises:
        BadInput: few sparse points lie on the building, and its masks have no place in common.
    """
    views, labels = [], []
    for i in indices:
        view = scene.views[i]
        view = scaled_view(view, min(1.0, options.longest_side / max(view.width, view.height)))
        size = (view.width, view.height)
        views.append(view)
        labels.append(np.asarray(cv2.resize(masks.labels[i], size, interpolation=cv2.INTER_NEAREST), np.uint8))
    points, seen = _points_of(scene, masks, indices, options)
    low, high, cells = _box(scene, masks, indices, points, options)
    middle = (low + high) / 2
    pixel = float(np.median([np.linalg.norm(view.centre - middle) / view.fx for view in views]))
    if len(points) >= options.hull.least_points:
        pixel = _pixel(points, seen, views)
    silhouettes = Silhouettes.of(views, labels)
    low, high = pad_box(low, high, options.padding)
    silhouettes = silhouettes.without(_find_faulty_masks(silhouettes, low, high, options))
    return StartViews(scene, list(indices), views, labels, silhouettes, points, seen, pixel, low, high, cells)


def _box(
    scene: Scene, masks: MaskSet, indices: Sequence[int], points: NDArray[np.float64], options: ViewOptions
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Compute the box around the sparse points and the visual hull, since plain parts have no points.

    Args:
        scene: the cameras.
        masks: the building in each photo.
        indices: the views.
        points: sparse points on the building, [N, 3].
        options: which of them count.

    Returns:
        low and high corner [3], and the hull's cells [C, 3], none where the masks have no place in common.

    Raises:
        BadInput: few points, and masks that have no place in common.
    """
    if len(points) < options.hull.least_points:
        cells, _ = hull_cells(scene, masks, indices, options.hull)
        return cells.min(0), cells.max(0), cells
    low, high = percentile_box(points, options.percentiles)
    try:
        cells, _ = hull_cells(scene, masks, indices, options.hull)
    except BadInput:
        return low, high, np.zeros((0, 3))
    return np.minimum(low, cells.min(0)), np.maximum(high, cells.max(0)), cells


def _points_of(
    scene: Scene, masks: MaskSet, indices: Sequence[int], options: ViewOptions
) -> tuple[NDArray[np.float64], list[NDArray[np.int64]]]:
    """Return the sparse points that enough views saw inside of their masks [N, 3], and positions of those views."""
    position = np.full(len(scene.views), -1)
    position[list(indices)] = np.arange(len(indices))
    number, point = position[scene.track_view], scene.track_point
    inside = np.zeros(len(number), bool)
    for i in indices:
        rows = scene.observations(i)
        inside[rows] = building(masks.labels[i])[pixel_at(masks.labels[i].shape, scene.track_uv[rows])]
    used = (number >= 0) & masks.point_mask[point]
    track = np.bincount(point[used], minlength=len(scene.points))
    agree = np.bincount(point[used & inside], minlength=len(scene.points))
    kept = np.flatnonzero((track >= options.least_track) & (agree > options.track_share * track))
    tracks = zip(scene.track_start[kept], scene.track_start[kept + 1], strict=True)
    return scene.points[kept], [np.unique(number[a:b][used[a:b]]) for a, b in tracks]


def _pixel(points: NDArray[np.float64], seen: Sequence[NDArray[np.int64]], views: Sequence[View]) -> float:
    """Return the median size of a pixel at points [N, 3] in the views that saw them."""
    number = np.concatenate(seen)
    owner = np.repeat(np.arange(len(points)), [len(s) for s in seen])
    size = np.zeros(len(number))
    for n, view in enumerate(views):
        rows = number == n
        size[rows] = view.project(points[owner[rows]])[1] / view.fx
    return float(np.median(size))


def _find_faulty_masks(
    silhouettes: Silhouettes, low: NDArray[np.float64], high: NDArray[np.float64], options: ViewOptions
) -> list[int]:
    """Find masks that cut off parts of the building; returns their positions.

    The coarse hull of the cells that only few masks call outside holds the building even where single masks fail. The
    mask that calls the largest share of it outside is faulty if that is far more than the median; then the next one is
    tested, up to half of the masks.
    """
    step = float((high - low).max()) / options.hull_cells
    axes = [np.arange(a, b, step) for a, b in zip(low, high, strict=True)]
    cells = grid_points(*axes)
    alone = OutsideOptions(least_views=1, share=0, margin=options.hull_margin)
    outside = np.stack([find_outside(cells, silhouettes.only(n), alone) for n in range(len(silhouettes.sizes))])
    trusted = np.ones(len(outside), bool)
    while trusted.sum() > len(outside) / 2:
        inside = outside[trusted].sum(0) < min(options.hull_views, len(outside))
        share = outside[:, inside].mean(1) if inside.any() else np.zeros(len(outside))
        worst = int(np.where(trusted, share, -1).argmax())
        if share[worst] < max(options.distrust_share, options.distrust_factor * float(np.median(share[trusted]))):
            break
        trusted[worst] = False
    return [int(n) for n in np.flatnonzero(~trusted)]
