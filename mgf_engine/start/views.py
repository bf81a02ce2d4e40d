# SPDX-License-Identifier: GPL-3.0-or-later
"""Prepare photos, cameras and masks of one building for the starting surface, at its working size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.geometry.rasterize import scaled_view
from mgf_engine.masks.geometry.visual_hull import hull_cells
from mgf_engine.model.masks import BACKGROUND, MaskSet, building
from mgf_engine.model.scene import Scene, View
from mgf_engine.native.library import parallel
from mgf_engine.start.options import ViewOptions


@dataclass(frozen=True)
class StartViews:
    """The ``V`` views that a starting surface is made from, in the normalised frame.

    Attributes:
        indices: their numbers in the scene.
        views: the cameras at working size.
        labels: uint8 [H, W] each.
        outside: uint8 [V, H, W] (of the largest photo), distance outside of the mask in eighths of a pixel.
        points, seen: sparse points on the building [N, 3], and of each the positions of the views that saw it.
        pixel: size of a pixel at the building.
        low, high: the box that holds it, [3] each.
        cells: centres of the cells of its coarse visual hull [C, 3].
    """

    scene: Scene
    indices: list[int]
    views: list[View]
    labels: list[NDArray[np.uint8]]
    outside: NDArray[np.uint8]
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
    def projections(self) -> NDArray[np.float64]:
        """Matrices [V, 3, 4] that take points to pixels."""
        return np.ascontiguousarray(np.stack([projection(view) for view in self.views]))

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

    def outside_views(self, points: NDArray[np.float64], margin: float, enough: int = 255) -> NDArray[np.uint8]:
        """Count the views that call points [N, 3] outside by more than ``margin`` px, up to ``enough``; uint8 [N]."""
        return count_outside(points, self.projections, self.outside, margin, enough)


def projection(view: View) -> NDArray[np.float64]:
    """Return the matrix [3, 4] that takes points in the normalised frame to pixels."""
    return np.asarray(view.intrinsics @ np.c_[view.rotation, view.translation])


def count_outside(
    points: NDArray[np.float64], projections: NDArray[np.float64], outside: NDArray[np.uint8], margin: float,
    enough: int = 255,
) -> NDArray[np.uint8]:  # fmt: skip
    """Count views that call each point outside (kernel ``mgf_count_outside``).

    Args:
        points: [N, 3], normalised frame.
        projections: [V, 3, 4], points to pixels.
        outside: distances outside of the masks in eighths of a pixel, uint8 [V, H, W].
        margin: px from the mask from which a point is outside.
        enough: count up to which views are asked.

    Returns:
        uint8 [N].
    """
    result = np.zeros(len(points), np.uint8)
    points, (views, height, width) = np.ascontiguousarray(points, dtype=np.float64), outside.shape
    parallel(
        "mgf_count_outside", len(points), points, projections, views, outside, height, width, float(margin), enough,
        result,
    )  # fmt: skip
    return result


def start_views(scene: Scene, masks: MaskSet, indices: Sequence[int], o: ViewOptions) -> StartViews:
    """Prepare views of a scene for the starting surface.

    Args:
        scene: photos, cameras and sparse points.
        masks: the building in each photo.
        indices: the views.
        o: working size, and which points and masks count.

    Raises:
        BadInput: few sparse points lie on the building, and its masks have no place in common.
    """
    views, labels = [], []
    for i in indices:
        view = scene.views[i]
        view = scaled_view(view, min(1.0, o.longest_side / max(view.width, view.height)))
        size = (view.width, view.height)
        views.append(view)
        labels.append(np.asarray(cv2.resize(masks.labels[i], size, interpolation=cv2.INTER_NEAREST), np.uint8))
    points, seen = _points_of(scene, masks, indices, o)
    low, high, cells = _box(scene, masks, indices, points, o)
    pad = o.padding * float((high - low).max())
    middle = (low + high) / 2
    pixel = float(np.median([np.linalg.norm(view.centre - middle) / view.fx for view in views]))
    if len(points) >= o.hull.least_points:
        pixel = _pixel(points, seen, views)
    outside = _outside(labels)
    result = StartViews(scene, list(indices), views, labels, outside, points, seen, pixel, low - pad, high + pad, cells)
    for number in _distrusted(result, o):
        outside[number] = 0
    return result


def _box(
    scene: Scene, masks: MaskSet, indices: Sequence[int], points: NDArray[np.float64], o: ViewOptions
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Compute the box around the sparse points and the visual hull, since plain parts have no points.

    Args:
        scene: the cameras.
        masks: the building in each photo.
        indices: the views.
        points: sparse points on the building, [N, 3].
        o: which of them count.

    Returns:
        low and high corner [3], and the hull's cells [C, 3], none where the masks have no place in common.

    Raises:
        BadInput: few points, and masks that have no place in common.
    """
    if len(points) < o.hull.least_points:
        cells, _ = hull_cells(scene, masks, indices, o.hull)
        return cells.min(0), cells.max(0), cells
    low, high = np.percentile(points, o.percentiles, axis=0)
    try:
        cells, _ = hull_cells(scene, masks, indices, o.hull)
    except BadInput:
        return low, high, np.zeros((0, 3))
    return np.minimum(low, cells.min(0)), np.maximum(high, cells.max(0)), cells


def _points_of(
    scene: Scene, masks: MaskSet, indices: Sequence[int], o: ViewOptions
) -> tuple[NDArray[np.float64], list[NDArray[np.int64]]]:
    """Return the sparse points that enough views saw inside of their masks [N, 3], and positions of those views."""
    position = np.full(len(scene.views), -1)
    position[list(indices)] = np.arange(len(indices))
    number, point = position[scene.track_view], scene.track_point
    inside = np.zeros(len(number), bool)
    for i in indices:
        rows = scene.observations(i)
        at = np.floor(scene.track_uv[rows]).astype(int)
        inside[rows] = building(masks.labels[i])[at[:, 1], at[:, 0]]
    used = (number >= 0) & masks.point_mask[point]
    track = np.bincount(point[used], minlength=len(scene.points))
    agree = np.bincount(point[used & inside], minlength=len(scene.points))
    kept = np.flatnonzero((track >= o.least_track) & (agree > o.track_share * track))
    seen = [np.unique(number[a:b][used[a:b]]) for a, b in zip(scene.track_start[kept], scene.track_start[kept + 1])]  # noqa: B905
    return scene.points[kept], seen


def _pixel(points: NDArray[np.float64], seen: Sequence[NDArray[np.int64]], views: Sequence[View]) -> float:
    """Return the median size of a pixel at points [N, 3] in the views that saw them."""
    number = np.concatenate(seen)
    owner = np.repeat(np.arange(len(points)), [len(s) for s in seen])
    size = np.zeros(len(number))
    for n, view in enumerate(views):
        rows = number == n
        size[rows] = view.project(points[owner[rows]])[1] / view.fx
    return float(np.median(size))


def _outside(labels: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Compute the distance outside of each mask in eighths of a pixel; ignored pixels are not outside."""
    height, width = (max(label.shape[k] for label in labels) for k in range(2))
    result = np.zeros((len(labels), height, width), np.uint8)
    for out, label in zip(result, labels, strict=True):
        distance = cv2.distanceTransform((label == BACKGROUND).astype(np.uint8), cv2.DIST_L2, 5)
        out[: label.shape[0], : label.shape[1]] = np.minimum(8 * distance, 255)
    return result


def _distrusted(views: StartViews, o: ViewOptions) -> list[int]:
    """Find masks that cut off parts of the building.

    The coarse hull of what few masks call outside holds the building even where single masks fail. A mask that calls
    far more of it outside than the others do is not trusted; one at a time, and at most half of them.
    """
    step = float((views.high - views.low).max()) / o.hull_cells
    axes = [np.arange(a, b, step) for a, b in zip(views.low, views.high, strict=True)]
    cells = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    each = zip(views.projections, views.outside, strict=True)
    says = np.stack([count_outside(cells, p[None].copy(), d[None], o.hull_margin) > 0 for p, d in each])
    trusted = np.ones(len(says), bool)
    while trusted.sum() > len(says) / 2:
        inside = says[trusted].sum(0) < min(o.hull_views, len(says))
        share = says[:, inside].mean(1) if inside.any() else np.zeros(len(says))
        worst = int(np.where(trusted, share, -1).argmax())
        if share[worst] < max(o.distrust_share, o.distrust_factor * float(np.median(share[trusted]))):
            break
        trusted[worst] = False
    return [int(n) for n in np.flatnonzero(~trusted)]
