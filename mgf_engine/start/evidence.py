# SPDX-License-Identifier: GPL-3.0-or-later
"""Gather the points of the tetrahedra: observed points with their visibility, and Steiner points without."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mgf_engine.errors import BadInput
from mgf_engine.start.dense import DensePoints
from mgf_engine.start.lines import Line3D, line_points
from mgf_engine.start.options import StartOptions
from mgf_engine.start.plane_points import crease_points, plane_points
from mgf_engine.start.planes import LinePlanes
from mgf_engine.start.snapping import snap_to_planes
from mgf_engine.start.views import StartViews

log = logging.getLogger("mgf")
_MAX_VIEWS = 1 << 16  # views that pairs of a point and a view are numbered for

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Evidence:
    """Points that the surface may pass through, and what photos and planes say about them.

    Attributes:
        points: [N, 3], normalised frame.
        seen: positions of the views that saw each; none for points that only shape the tetrahedra.
        weight: of each point's rays, [N].
        on_planes: which points lie on which planes, bool [N, K].
        strength: 0..1 of each plane, [K].
    """

    points: Array
    seen: Sequence[NDArray[np.int64]]
    weight: Array
    on_planes: NDArray[np.bool_]
    strength: Array

    def select(self, rows: NDArray[np.int64]) -> Evidence:
        """Return the points with these numbers."""
        seen = [self.seen[row] for row in rows.tolist()]
        return Evidence(self.points[rows], seen, self.weight[rows], self.on_planes[rows], self.strength)


class _Group(NamedTuple):
    """Points of one kind.

    Attributes:
        points: [N, 3], normalised frame.
        seen: positions of the views that saw each.
        weight: of each point's rays, [N].
        near: distance up to which they are moved onto planes, px.
    """

    points: Array
    seen: Sequence[NDArray[np.int64]]
    weight: Array
    near: float


def gather_evidence(
    views: StartViews, lines: Sequence[Line3D], planes: LinePlanes, dense: DensePoints, options: StartOptions
) -> Evidence:
    """Gather points on lines, sparse and stereo points, and Steiner points, all moved onto the planes near by.

    Args:
        views: cameras, masks and sparse points.
        lines: in the normalised frame.
        planes: through the lines.
        dense: points by stereo.
        options: of the lines, the planes and the cut.

    Raises:
        BadInput: hardly any points.
    """
    plane_options, pixel = options.planes, views.pixel
    on_lines, lines_seen = line_points(lines, pixel, options.segments)
    groups = [
        _Group(on_lines, lines_seen, np.ones(len(on_lines)), plane_options.near),
        _Group(views.points, views.seen, np.ones(len(views.points)), plane_options.near_sparse * plane_options.near),
        _Group(dense.points, dense.seen, dense.weight, plane_options.near_dense * plane_options.near),
    ]
    if sum(len(group.points) for group in groups) < options.cut.least_points:
        raise BadInput(
            "The photos show too few edges and points on the building for a surface; add photos that overlap more."
        )
    for points in _steiner_points(views, planes, lines, dense, options):
        groups.append(_Group(points, [np.zeros(0, np.int64)] * len(points), np.zeros(len(points)), plane_options.near))
    log.info("start: %d planes; points on lines, sparse, dense, creases, planes, behind, in the hull: %s",
             len(planes.planes), [len(group.points) for group in groups])  # fmt: skip
    near = np.concatenate([np.full(len(group.points), group.near * pixel) for group in groups])
    points, on = snap_to_planes(np.concatenate([group.points for group in groups]), planes, near, plane_options)
    weight, seen = np.concatenate([group.weight for group in groups]), [s for group in groups for s in group.seen]
    return merge_points(
        Evidence(points, seen, weight, on, _relative_strength(planes, plane_options.strongest)),
        options.cut.merge * pixel,
    )


def _steiner_points(
    views: StartViews, planes: LinePlanes, lines: Sequence[Line3D], dense: DensePoints, options: StartOptions
) -> list[Array]:
    """Place points that only shape the tetrahedra: on creases and planes, behind stereo points, coarse in the hull.

    Without points behind a thin part its tetrahedra reach to the wall behind it, and rays to that wall cross them.
    Points in the hull give a volume to parts that no photo shows.

    Args:
        views: cameras and masks.
        planes: through the lines.
        lines: which the planes' members number.
        dense: points by stereo.
        options: of the planes and the cut.

    Returns:
        points [N, 3] of each of the four kinds.
    """
    plane_options, pixel = options.planes, views.pixel

    def in_hull(points: Array) -> NDArray[np.bool_]:
        return ~views.is_outside(points, options.cut.outside)

    points, owner = plane_points(planes, lines, dense.points, pixel, plane_options)
    kept = in_hull(points)
    points, owner = points[kept], owner[kept]
    creases = crease_points(planes, points, owner, pixel, plane_options)
    behind = _off_surface(dense, options.cut.off_surface * pixel)
    coarse = _coarse_cells(views.cells, [dense.points, points])
    return [creases[in_hull(creases)], points, behind[in_hull(behind)], coarse]


def _off_surface(dense: DensePoints, distance: float) -> Array:
    """Place points ``distance`` behind those by stereo (Carr et al. 2001), one per cube of that side."""
    if distance <= 0:
        return np.zeros((0, 3))
    points = dense.points - distance * dense.normals
    voxel = np.floor(points / distance).astype(np.int64)
    return points[np.sort(np.unique(voxel, axis=0, return_index=True)[1])]


def _coarse_cells(cells: Array, others: Sequence[Array]) -> Array:
    """Take every second cell [C, 3] in each direction that has no other point within its size."""
    if len(cells) < 2:
        return cells
    size = float(np.diff(np.unique(cells[:, 0].round(9))).min(initial=np.inf))
    if not np.isfinite(size):
        return cells
    number = np.round((cells - cells.min(0)) / size).astype(int)
    coarse = cells[(number % 2 == 0).all(1)]
    tree = cKDTree(np.concatenate(others))
    return coarse[tree.query(coarse, distance_upper_bound=2 * size)[0] == np.inf] if tree.n else coarse


def _relative_strength(planes: LinePlanes, strongest: int) -> Array:
    """Divide the planes' strengths by the mean of the strongest, 0..1, [K]."""
    if not len(planes.strength):
        return planes.strength
    return np.clip(planes.strength / np.sort(planes.strength)[-strongest:].mean(), 1e-3, 1)


def merge_points(evidence: Evidence, size: float) -> Evidence:
    """Merge the points of each cube of ``size``: the first one, all their views, the largest weight."""
    points, seen = evidence.points, evidence.seen
    cube = np.round((points - points.min(0)) / size).astype(np.int64)
    number = np.ravel_multi_index(tuple(cube.T), tuple(cube.max(0) + 1))
    _, first, group = np.unique(number, return_index=True, return_inverse=True)
    largest = np.zeros(len(first))
    np.maximum.at(largest, group, evidence.weight)
    count = np.array([len(s) for s in seen])
    pair = np.unique(np.repeat(group, count) * _MAX_VIEWS + np.concatenate([np.zeros(0, np.int64), *seen]))
    owner, view = np.divmod(pair, _MAX_VIEWS)
    together = np.split(view, np.searchsorted(owner, np.arange(1, len(first))))
    return Evidence(points[first], together, largest, evidence.on_planes[first], evidence.strength)
