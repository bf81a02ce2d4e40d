# SPDX-License-Identifier: GPL-3.0-or-later
"""Label Delaunay tetrahedra inside or outside by a visibility-weighted minimum s-t cut (after Labatut et al. 2007).

Unary terms: tetrahedra with a camera or outside of the silhouettes are outside, those behind a point are inside, and
the volume of the visual hull has a small reward for being inside. Pairwise terms: a face between inside and outside
costs the visibility rays that cross it and its area, which is cheaper on planes through lines. Mask pixels that the
first surface does not cover add inside terms along their viewing rays, and a second cut is computed.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.boxes import grid_points
from mgf_engine.geometry.rasterize import render_mesh
from mgf_engine.geometry.tetgen import background_delaunay
from mgf_engine.model.masks import building
from mgf_engine.model.mesh import Mesh
from mgf_engine.native.library import parallel
from mgf_engine.start.cut_graph import ONE, CutGraph
from mgf_engine.start.evidence import Evidence
from mgf_engine.start.options import MinimumCutOptions
from mgf_engine.start.tetrahedra import Tetrahedra, orient_positive
from mgf_engine.start.views import StartViews, pixel_rays
from mgf_engine.system.machine import release_memory

log = logging.getLogger("mgf")
_HARD_CAPACITY = 1e9  # capacity of hard constraints; no sum of other terms exceeds it
#: Barycentric coordinates of the points of a tetrahedron that are tested against the masks.
_SAMPLES = np.array([[0.25] * 4, *(np.eye(4) * 0.6 + 0.1)])

Array = NDArray[np.float64]


def cut_surface(
    views: StartViews, evidence: Evidence, options: MinimumCutOptions, check: Callable[[], None]
) -> tuple[Mesh, NDArray[np.float32]]:
    """Compute the closed surface by the minimum cut of the graph of tetrahedra.

    Args:
        views: cameras and masks.
        evidence: points, their rays and their planes.
        options: weights.
        check: called between the steps; may raise to cancel.

    Returns:
        The surface, and the strength of the strongest plane each of its faces lies on, 0 on none, float32 [F].

    Raises:
        Cancelled: the user asked to stop.
    """
    low, high = evidence.points.min(0), evidence.points.max(0)
    padding = options.padding * float((high - low).max())
    points = np.concatenate([evidence.points, _box(low, high, padding)])
    with background_delaunay(points) as made:
        tetrahedra = Tetrahedra(points, orient_positive(points, made(check)))
    outside = _outside_share(views, tetrahedra, options)
    fixed_outside = (outside > options.outside_share) | (tetrahedra.corners >= len(evidence.points)).any(1)
    free, solid, face = _cast_rays(views, tetrahedra, evidence, options)
    check()
    sink = np.empty(len(fixed_outside))
    for chunk in tetrahedra.chunks():
        # Rays through a tetrahedron reduce the reward of its volume: a courtyard lies in the visual hull, but is free.
        free_space = np.maximum(face[chunk].sum(1) / ONE - options.free_space, 0)
        hull = options.volume * tetrahedra.volumes(chunk) / views.pixel**3 * (1 - outside[chunk])
        sink[chunk] = solid[chunk] / ONE + np.maximum(hull - free_space, 0)
    source = np.where(fixed_outside, _HARD_CAPACITY, free / ONE)
    del outside, free, solid
    graph = CutGraph(tetrahedra, face, evidence, views.pixel, options)
    del face
    graph.flow.add(source, sink)
    del source, sink
    first, _ = graph.surface(graph.flow.cut())
    check()
    margin = 0.1 * padding
    release_memory()  # the graph and the planes of the next walk are the largest there is
    pulled = _pull_uncovered(views, tetrahedra, fixed_outside, first, (low - margin, high + margin), options)
    graph.flow.add(np.zeros(len(pulled)), pulled / ONE)
    inside = graph.flow.cut()
    log.info("start: %d points, %d tetrahedra, %d inside", len(points), len(inside), inside.sum())
    return graph.surface(inside)


def _box(low: Array, high: Array, padding: float) -> Array:
    """Return 26 points [26, 3] on a padded box: its corners, and the middles of its edges and sides."""
    sides = np.stack([low - padding, (low + high) / 2, high + padding], 1)
    return np.delete(grid_points(*sides), 13, 0)


def _outside_share(views: StartViews, tetrahedra: Tetrahedra, options: MinimumCutOptions) -> Array:
    """Compute the share of each tetrahedron outside of the visual hull, [T]."""
    share = np.zeros(len(tetrahedra.corners))
    for chunk in tetrahedra.chunks():
        corners = tetrahedra.points[tetrahedra.corners[chunk]]
        for row in _SAMPLES:
            share[chunk] += views.is_outside(row @ corners, options.outside)
    return share / len(_SAMPLES)


def _cast_rays(
    views: StartViews, tetrahedra: Tetrahedra, evidence: Evidence, options: MinimumCutOptions
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """Cast the points' rays (kernel ``mgf_tetra_rays``).

    Returns:
        Weights in units of 1 / ``ONE``: of the tetrahedra with a view [T], of those behind a point [T], and of the
        rays that leave through each face [T, 4].
    """
    point = np.repeat(np.arange(len(evidence.points), dtype=np.int32), [len(s) for s in evidence.seen])
    view = np.concatenate([np.zeros(0, np.int64), *evidence.seen]).astype(np.int32)
    weight = evidence.weight[point].astype(np.float32)
    behind = (options.behind * weight * _well_inside(views, evidence.points[point], view, options.well_inside)).astype(
        np.float32
    )
    free, solid = np.zeros(len(tetrahedra.corners), np.int32), np.zeros(len(tetrahedra.corners), np.int32)
    face = np.zeros((len(tetrahedra.corners), 4), np.int32)
    with tetrahedra.kernel_table(from_points=True) as table:
        parallel(
            "mgf_tetra_rays", len(point), table, point, view, views.centres, weight, behind,
            float(options.soft * views.pixel), float(options.depth * views.pixel), free, solid, face,
        )  # fmt: skip
    return free, solid, face


def _well_inside(views: StartViews, points: Array, number: NDArray[np.int32], margin: float) -> NDArray[np.bool_]:
    """Tell which points [R, 3] lie more than ``margin`` px inside of the mask of their view [R], bool [R]."""
    result = np.zeros(len(points), bool)
    for n, view in enumerate(views.views):
        rows = np.flatnonzero(number == n)
        into = cv2.distanceTransform(building(views.labels[n]).astype(np.uint8), cv2.DIST_L2, 5)
        uv = np.floor(view.project(points[rows])[0])
        column, row = np.clip(uv, 0, [view.width - 1, view.height - 1]).astype(int).T
        result[rows] = into[row, column] > margin
    return result


def _pull_uncovered(
    views: StartViews,
    tetrahedra: Tetrahedra,
    fixed_outside: NDArray[np.bool_],
    mesh: Mesh,
    box: tuple[Array, Array],
    options: MinimumCutOptions,
) -> NDArray[np.int32]:
    """Compute inside weights of tetrahedra on rays of uncovered mask pixels (kernel ``mgf_tetra_pull``).

    Args:
        views: cameras and masks.
        tetrahedra: all tetrahedra.
        fixed_outside: tetrahedra constrained to be outside, bool [T].
        mesh: the surface.
        box: low and high corner [3] of the space that the rays are followed in.
        options: weights.

    Returns:
        int32 [T], in units of 1 / ``ONE``.
    """
    origin, direction = _uncovered(views, mesh, box)
    pulled = np.zeros(len(fixed_outside), np.int32)
    with tetrahedra.kernel_table() as table:
        parallel(
            "mgf_tetra_pull", len(origin), table, origin, direction, fixed_outside.astype(np.uint8),
            float(options.cover), float(options.short * views.pixel), pulled,
        )  # fmt: skip
    log.info("start: %d mask pixels uncovered at first", len(origin))
    return pulled


def _uncovered(views: StartViews, mesh: Mesh, box: tuple[Array, Array]) -> tuple[Array, Array]:
    """Find the rays of mask pixels that the surface does not cover.

    Args:
        views: cameras and masks.
        mesh: the surface.
        box: low and high corner [3]; rays that miss it are left out.

    Returns:
        where they enter the box, and their directions, [M, 3] each.
    """
    starts, directions = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for n, view in enumerate(views.views):
        wanted = cv2.erode(building(views.labels[n]).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        row, column = np.nonzero(wanted & (render_mesh(mesh, view).face < 0))
        found = pixel_rays(views, np.full(len(row), n), np.c_[column + 0.5, row + 0.5])
        centre = np.broadcast_to(views.centres[n], found.shape)
        begin = _entry(centre, found, *box)
        hit = np.isfinite(begin)
        starts.append(centre[hit] + begin[hit, None] * found[hit])
        directions.append(found[hit])
    return np.concatenate(starts), np.concatenate(directions)


def _entry(origin: Array, direction: Array, low: Array, high: Array) -> Array:
    """Return the distance at which rays [M, 3] enter the box low..high, inf where they miss it, [M]."""
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (low - origin) / direction, (high - origin) / direction
    near, far = np.minimum(first, second).max(1), np.maximum(first, second).min(1)
    return np.where(far > np.maximum(near, 0), np.maximum(near, 0) + 1e-6, np.inf)
