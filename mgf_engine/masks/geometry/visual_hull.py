# SPDX-License-Identifier: GPL-3.0-or-later
"""Carve the visual hull of the masks; its surface cells replace missing sparse points.

Nadir photos of shingles, or photos of plain walls, share few sparse points on the building. The surface cells of the
hull then serve as points: for the choice of neighbouring photos, and for the range of depths.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.geometry.boxes import grid_points, pad_box, percentile_box
from mgf_engine.model.masks import BACKGROUND, MaskSet, building
from mgf_engine.model.scene import Scene, View, most_pixels
from mgf_engine.native.parallel import parallel_map
from mgf_engine.options.algorithms import parameter
from mgf_engine.scene.neighbours import MatchingPoints
from mgf_engine.system.memory import share

_BYTES_PER_CELL, _BYTES_PER_PIXEL = 150, 6  # while a view votes on the cells
_BYTES_PER_DISTANCE = 4  # of a pixel of a distance map
_KEPT = 0.1, 1 << 29  # distance maps that are kept for all rounds: share of the memory budget, and bytes at most
_FEWEST = 8  # sparse points that bound the box in which the hull is looked for


@dataclass(frozen=True)
class MaskHullOptions:
    """Options of the visual hull that stands in for missing sparse points."""

    least_points: int = parameter(
        100, "Number of sparse points on the building below which cells of the hull stand in for them"
    )
    least_matched: float = parameter(
        0.33,
        "Share of the photos that must share sparse points on the building with another, or cells stand in",
        high=1,
    )
    cells: int = parameter(48, "Number of cells along the longest side of the hull's box", low=4)
    rounds: int = parameter(3, "Number of times that the hull is carved, each time in the box of the one before", low=1)
    outside_share: float = parameter(0.15, "Share of the photos that may call a cell of the hull outside", high=1)
    least_views: int = parameter(2, "Minimum number of photos that show a cell on the building", low=1)
    percentiles: tuple[float, float] = parameter(
        (3.0, 97.0), "Percentiles of the sparse points between which the first box lies", high=100
    )
    padding: float = parameter(0.2, "Padding of this box, as a share of its longest side")
    building_padding: float = parameter(
        0.5,
        "Padding of the box of the sparse points on the building, as a share of its longest side; a hull that reaches "
        "beyond twice that is carved again in it",
    )


@dataclass(frozen=True)
class HullVotes:
    """Votes of masks on the cells of a grid; the visual hull is the cells that enough call building and few outside.

    Attributes:
        cells: centres [N, 3], normalised frame.
        size: of a cell.
        inside, outside: number of masks that call each cell building, and outside of it, int32 [N].
    """

    cells: NDArray[np.float64]
    size: float
    inside: NDArray[np.int32]
    outside: NDArray[np.int32]

    def hull(self, options: MaskHullOptions, forgiven: int = 0) -> NDArray[np.bool_]:
        """Tell which cells are of the hull, bool [N].

        Args:
            options: how many masks may call a cell outside.
            forgiven: number of votes against each cell that do not count.
        """
        outside = np.maximum(self.outside - forgiven, 0)
        return (self.inside >= options.least_views) & (outside <= options.outside_share * (self.inside + outside))


def hull_cells(
    scene: Scene, masks: MaskSet, views: Sequence[int], options: MaskHullOptions = MaskHullOptions()
) -> tuple[NDArray[np.float64], float]:
    """Carve the visual hull of the masks of ``views``: centres [N, 3] of its cells, and their size.

    Args:
        scene: normalised frame.
        masks: label maps of all its views.
        views: those whose masks carve the hull.
        options: number of cells, and how many views may disagree.

    Raises:
        BadInput: the hull is empty.
    """
    votes = carve(scene, masks, views, options)
    return votes.cells[votes.hull(options)], votes.size


def carve(scene: Scene, masks: MaskSet, views: Sequence[int], options: MaskHullOptions, forgiven: int = 0) -> HullVotes:
    """Let the masks of ``views`` vote on the cells around their visual hull.

    Args:
        scene: normalised frame.
        masks: label maps of all its views.
        views: those whose masks vote.
        options: number of cells, and how many views may disagree.
        forgiven: as :meth:`HullVotes.hull` takes it.

    Raises:
        BadInput: the hull is empty.
    """
    distances = _keep_distances(masks, views)
    votes = _carve_in(_seen_box(scene, views, options), scene, masks, views, distances, options, forgiven)
    points = scene.points[masks.point_mask]
    if len(points) < options.least_points or not _runs_away(
        votes.cells[votes.hull(options, forgiven)], points, options
    ):
        return votes
    box = percentile_box(points, options.percentiles, options.building_padding)
    return _carve_in(box, scene, masks, views, distances, options, forgiven)


def _carve_in(
    box: tuple[NDArray[np.float64], NDArray[np.float64]],
    scene: Scene,
    masks: MaskSet,
    views: Sequence[int],
    distances: Mapping[int, NDArray[np.float32]],
    options: MaskHullOptions,
    forgiven: int,
) -> HullVotes:
    """Let masks vote on the cells of a box (low and high corner [3]), then on those of the box of the hull so far.

    Args:
        box: low and high corner [3].
        scene: normalised frame.
        masks: label maps of all its views.
        views: those whose masks vote.
        distances: of the views that are kept in memory, see :func:`background_distance`.
        options: number of cells and rounds.
        forgiven: as :meth:`HullVotes.hull` takes it.

    Raises:
        BadInput: the hull is empty.
    """
    low, high = box
    for _ in range(options.rounds):
        size = float((high - low).max()) / options.cells
        axes = [np.arange(a + size / 2, b + size / 2, size) for a, b in zip(low, high, strict=True)]
        cells = grid_points(*axes)
        votes = _count_votes(cells, size, scene, masks, views, distances)
        found = cells[votes.hull(options, forgiven)]
        if not len(found):
            raise BadInput(
                "The masks have no common volume: no point in space lies inside most of them; check the masks, the "
                "clicks and the cameras."
            )
        low, high = found.min(0) - 2 * size, found.max(0) + 2 * size
    return votes


def with_hull_points(
    scene: Scene, masks: MaskSet, views: Sequence[int], options: MaskHullOptions = MaskHullOptions()
) -> MatchingPoints:
    """Return enough points on the building to match photos by: surface cells of the hull if sparse points are few.

    Args:
        scene: cameras and sparse points.
        masks: the building in each photo.
        views: indices of the views whose masks carve the hull.
        options: of the hull.

    Returns:
        The sparse points on the building; or the scene with the hull's cells in their place.

    Raises:
        BadInput: there are few points, and the hull is empty.
    """
    sparse = MatchingPoints(scene, masks.point_mask, views)
    if np.count_nonzero(masks.point_mask) >= options.least_points:
        matched = sum(len(near) > 0 for near in sparse.neighbours(1).values())
        if matched >= options.least_matched * len(views):
            return sparse
    cells, size = hull_cells(scene, masks, views, options)
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
    return MatchingPoints(hull, np.ones(len(cells), bool), views)


def points_to_match(
    scene: Scene, masks: MaskSet, views: Sequence[int], options: MaskHullOptions = MaskHullOptions()
) -> MatchingPoints:
    """Call :func:`with_hull_points`, but return the sparse points, however few, if the hull is empty.

    Stereo matching then leaves photos without shared points unmatched.

    Args:
        scene: normalised frame.
        masks: label maps of all its views.
        views: those whose masks carve the hull.
        options: of the hull.
    """
    try:
        return with_hull_points(scene, masks, views, options)
    except BadInput:
        return MatchingPoints(scene, masks.point_mask, views)


def _seen_box(
    scene: Scene, views: Sequence[int], options: MaskHullOptions
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the box, low and high [3], of the sparse points; of what all cameras look at where there are few."""
    centres = np.stack([scene.views[i].centre for i in views])
    axes = np.stack([scene.views[i].rotation[2] for i in views])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    middle = np.linalg.lstsq(across.sum(0), np.einsum("vij,vj->i", across, centres), rcond=1e-6)[0]
    low, high = middle - 1, middle + 1
    if len(scene.points) >= _FEWEST:
        low, high = percentile_box(scene.points, options.percentiles)
    return pad_box(low, high, options.padding)


def _runs_away(cells: NDArray[np.float64], points: NDArray[np.float64], options: MaskHullOptions) -> bool:
    """Tell whether a hull reaches far beyond the building.

    Photos side by side whose background is far away see the building in front of the same place behind it, and no other
    photo has that place in its frame: their silhouettes meet to infinity.

    Args:
        cells: of the hull, [N, 3].
        points: sparse points on the building, [M, 3].
        options: how far is far.
    """
    low, high = percentile_box(points, options.percentiles, 2 * options.building_padding)
    return bool((cells < low).any() or (cells > high).any())


def vote_on_cells(
    cells: NDArray[np.float64], size: float, view: View, labels: NDArray[np.uint8], distance: NDArray[np.float32]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Let one mask vote on the cells in its frame: building where it touches a cell, outside beyond.

    Args:
        cells: centres [N, 3], normalised frame.
        size: of a cell.
        view: the camera.
        labels: its label map, uint8 [H, W].
        distance: see :func:`background_distance`.

    Returns:
        Which cells lie in the frame, bool [N], and which of these M the mask calls building, and outside, bool [M].
    """
    uv, depth, framed = view.project_into_frame(cells)
    column, row = uv[framed].astype(int).T
    at = row, column
    reach = 0.5 * size * view.fx / np.maximum(depth[framed], 1e-9)
    beside = distance[at]
    return framed, building(labels[at]) | ((beside > 0) & (beside <= reach)), beside > reach


def background_distance(labels: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Compute the distance of background pixels to the nearest other one, px; 0 for others; float32 [H, W]."""
    return np.asarray(cv2.distanceTransform((labels == BACKGROUND).astype(np.uint8), cv2.DIST_L2, 3), np.float32)


def _count_votes(
    cells: NDArray[np.float64],
    size: float,
    scene: Scene,
    masks: MaskSet,
    views: Sequence[int],
    distances: Mapping[int, NDArray[np.float32]],
) -> HullVotes:
    """Count the votes of the masks of ``views`` on cells [N, 3]; ``distances`` of views that are kept in memory."""
    inside, outside = np.zeros(len(cells), np.int32), np.zeros(len(cells), np.int32)

    def vote(i: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        labels = masks.labels[i]
        distance = distances[i] if i in distances else background_distance(labels)
        return vote_on_cells(cells, size, scene.views[i], labels, distance)

    each = _BYTES_PER_CELL * len(cells) + _BYTES_PER_PIXEL * most_pixels([scene.views[i] for i in views])
    for framed, on_it, off_it in parallel_map(vote, views, bytes_each=each):
        inside[framed] += on_it
        outside[framed] += off_it
    return HullVotes(cells, size, inside, outside)


def _keep_distances(masks: MaskSet, views: Sequence[int]) -> dict[int, NDArray[np.float32]]:
    """Return :func:`background_distance` of as many of the views as memory is spared for."""
    largest = max((masks.labels[i].size for i in views), default=1)
    kept = views[: share(*_KEPT) // (_BYTES_PER_DISTANCE * largest)]
    distances = parallel_map(lambda i: background_distance(masks.labels[i]), kept)
    return dict(zip(kept, distances, strict=True))


def _surface(cells: NDArray[np.float64], size: float) -> NDArray[np.bool_]:
    """Tell which cells [N, 3] have a free neighbour, bool [N]."""
    key = np.round((cells - cells.min(0)) / size).astype(int) + 1
    full = np.zeros(key.max(0) + 2, bool)
    full[tuple(key.T)] = True
    steps = np.concatenate([np.eye(3, dtype=int), -np.eye(3, dtype=int)])
    return ~np.all([full[tuple((key + step).T)] for step in steps], axis=0)


def _inside(cells: NDArray[np.float64], scene: Scene, masks: MaskSet, index: int) -> NDArray[np.bool_]:
    """Tell which cells [N, 3] a photo shows inside its mask and on the near side of the building, bool [N]."""
    uv, depth, result = scene.views[index].project_into_frame(cells)
    column, row = uv[result].astype(int).T
    result[result] = building(masks.labels[index])[row, column]
    near = np.zeros(len(cells), bool)
    near[np.argsort(depth)[: max(8, len(cells) // 2)]] = True  # the far half is hidden by the near one
    return result & near
