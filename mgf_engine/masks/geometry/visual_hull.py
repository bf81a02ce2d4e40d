# SPDX-License-Identifier: GPL-3.0-or-later
"""The visual hull: where in space the building can be, by its masks alone; it stands in for missing sparse points.

Photos straight down on shingles, or of plain walls, share few points on the building. The cells of the hull's surface
tell which photos see the same of it and how far away it is, as points would.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.model.masks import BACKGROUND, IGNORE, MaskSet, building
from mgf_engine.model.scene import Scene

FEW = 100  # sparse points on a building; with fewer the hull's cells stand in for them
_CELLS = 48  # along the longest side of the box
_OUTSIDE = 0.15  # share of the photos that may call a cell of the building outside
_LEAST = 2  # photos that must see a cell on the building
_ROUNDS = 3  # in which the box shrinks to what is found


def hull_cells(scene: Scene, masks: MaskSet, views: Sequence[int]) -> tuple[NDArray[np.float64], float]:
    """Centres [N, 3] of the cells that the masks of ``views`` leave to the building, and the cells' size.

    Raises:
        BadInput: the masks have no place in common.
    """
    low, high = _seen_box(scene, views)
    for _ in range(_ROUNDS):
        size = float((high - low).max()) / _CELLS
        axes = [np.arange(a + size / 2, b + size / 2, size) for a, b in zip(low, high, strict=True)]
        cells = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        found = cells[_on_building(cells, scene, masks, views, size)]
        if not len(found):
            raise BadInput(
                "The masks have no common volume: no point in space lies inside most of them; check the masks, the "
                "clicks and the cameras."
            )
        low, high = found.min(0) - 2 * size, found.max(0) + 2 * size
    return found, size


def with_hull_points(scene: Scene, masks: MaskSet, views: Sequence[int]) -> tuple[Scene, NDArray[np.bool_]]:
    """The scene and which of its points are on the building, [P]; cells of the hull as points where those are few."""
    if np.count_nonzero(masks.point_mask) >= FEW:
        return scene, masks.point_mask
    cells, size = hull_cells(scene, masks, views)
    cells = cells[_surface(cells, size)]
    tracks = [_inside(cells, scene, masks, i) for i in views]
    point, number = np.nonzero(np.stack(tracks, 1))
    seen = np.asarray(views)[number].astype(np.int32)
    start = np.searchsorted(point, np.arange(len(cells) + 1)).astype(np.int64)
    uv = np.zeros((len(seen), 2), np.float32)
    for i in views:
        rows = seen == i
        uv[rows] = scene.views[i].project(cells[point[rows]])[0]
    zeros = np.zeros(len(cells))
    hull = replace(
        scene, points=cells, colors=np.zeros((len(cells), 3), np.uint8), errors=zeros.astype(np.float32),
        track_start=start, track_view=seen, track_uv=uv,
    )  # fmt: skip
    return hull, np.ones(len(cells), bool)


def hull_agreement(scene: Scene, masks: MaskSet, others: Sequence[int], index: int) -> float | None:
    """Compute the intersection over union of a mask and the visual hull of the other views' masks.

    Returns:
        0..1; None where the others leave no hull, or none of it lies in this view's frame.
    """
    if len(others) < _LEAST:
        return None
    try:
        cells, size = hull_cells(scene, masks, others)
    except BadInput:
        return None
    view = scene.views[index]
    uv, depth = view.project(cells)
    framed = (depth > 0) & (uv >= 0).all(1) & (uv[:, 0] < view.width) & (uv[:, 1] < view.height)
    if not framed.any():
        return None
    cover = np.zeros((view.height, view.width), np.uint8)
    column, row = np.floor(uv[framed]).astype(int).T
    cover[row, column] = 1
    reach = int(np.ceil(size * view.fx / float(np.median(depth[framed])))) | 1
    hull = cv2.morphologyEx(cover, cv2.MORPH_CLOSE, np.ones((2 * reach + 1,) * 2, np.uint8)) > 0
    known = masks.labels[index] != IGNORE
    mask = building(masks.labels[index])
    return float((mask & hull & known).sum() / max(int(((mask | hull) & known).sum()), 1))


def points_to_match(scene: Scene, masks: MaskSet, views: Sequence[int]) -> tuple[Scene, NDArray[np.bool_]]:
    """As :func:`with_hull_points`, but the few points that there are where the masks have no place in common.

    For stereo, which can do without: photos that share no points are matched with none.
    """
    try:
        return with_hull_points(scene, masks, views)
    except BadInput:
        return scene, masks.point_mask


def _seen_box(scene: Scene, views: Sequence[int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A box of what the photos look at: sparse points if there are any, the cameras' own common place in any case."""
    centres = np.stack([scene.views[i].centre for i in views])
    axes = np.stack([scene.views[i].rotation[2] for i in views])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    middle = np.linalg.lstsq(across.sum(0), np.einsum("vij,vj->i", across, centres), rcond=1e-6)[0]
    around = [middle - 1, middle + 1]
    if len(scene.points) >= 8:
        around = [*np.percentile(scene.points, [3, 97], axis=0), *around[:0]]
    corners = np.stack(around)
    low, high = corners.min(0), corners.max(0)
    pad = 0.2 * float((high - low).max())
    return low - pad, high + pad


def _on_building(
    cells: NDArray[np.float64], scene: Scene, masks: MaskSet, views: Sequence[int], size: float
) -> NDArray[np.bool_]:
    """Cells that enough masks call building and few outside, bool [N]."""
    inside, outside = np.zeros(len(cells), np.int32), np.zeros(len(cells), np.int32)
    for i in views:
        view, labels = scene.views[i], masks.labels[i]
        uv, depth = view.project(cells)
        column, row = np.floor(uv[:, 0]), np.floor(uv[:, 1])
        framed = (depth > 0) & (column >= 0) & (row >= 0) & (column < view.width) & (row < view.height)
        at = row[framed].astype(int), column[framed].astype(int)
        reach = 0.5 * size * view.fx / np.maximum(depth[framed], 1e-9)
        beside = cv2.distanceTransform((labels == BACKGROUND).astype(np.uint8), cv2.DIST_L2, 3)[at]
        inside[framed] += building(labels)[at] | ((beside > 0) & (beside <= reach))
        outside[framed] += beside > reach
    return (inside >= _LEAST) & (outside <= _OUTSIDE * (inside + outside))


def _surface(cells: NDArray[np.float64], size: float) -> NDArray[np.bool_]:
    """Cells with a free neighbour, bool [N]."""
    key = np.round((cells - cells.min(0)) / size).astype(int) + 1
    full = np.zeros(key.max(0) + 2, bool)
    full[tuple(key.T)] = True
    steps = np.concatenate([np.eye(3, dtype=int), -np.eye(3, dtype=int)])
    return ~np.all([full[tuple((key + step).T)] for step in steps], axis=0)


def _inside(cells: NDArray[np.float64], scene: Scene, masks: MaskSet, index: int) -> NDArray[np.bool_]:
    """Cells on the near side of the building that a photo shows inside its mask, bool [N]."""
    view = scene.views[index]
    uv, depth = view.project(cells)
    column, row = np.floor(uv[:, 0]).astype(int), np.floor(uv[:, 1]).astype(int)
    framed = (depth > 0) & (column >= 0) & (row >= 0) & (column < view.width) & (row < view.height)
    result = np.zeros(len(cells), bool)
    result[framed] = building(masks.labels[index])[row[framed], column[framed]]
    near = np.zeros(len(cells), bool)
    near[np.argsort(depth)[: max(8, len(cells) // 2)]] = True  # the far half is hidden by the near one
    return result & near
