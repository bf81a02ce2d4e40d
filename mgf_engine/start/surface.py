# SPDX-License-Identifier: GPL-3.0-or-later
"""The starting surface of a building, from its photos, cameras and masks."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mgf_engine.errors import BadInput
from mgf_engine.messages import Reporter
from mgf_engine.model.masks import MaskSet
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import Scene
from mgf_engine.start.cut import Evidence, cut_surface
from mgf_engine.start.dense import DensePoints, dense_points
from mgf_engine.start.lines import Line, find_lines, line_points
from mgf_engine.start.options import StartOptions
from mgf_engine.start.planes import LinePlanes, crease_points, find_planes, plane_points, snap
from mgf_engine.start.segments import find_segments
from mgf_engine.start.views import StartViews, start_views
from mgf_engine.system import cores
from mgf_engine.timing import PartTimes

log = logging.getLogger("mgf")
_LEAST = 20  # points that carry evidence: with fewer there is no surface to find
_STRONGEST = 3  # planes that tell how strong a strong one is


@dataclass(frozen=True)
class StartSurface:
    """A closed surface in the normalised frame.

    Attributes:
        mesh: its triangles, outward; colours are 0.
        sure: 0..1 by the strength of the plane each face lies on, 0 on none, float32 [F].
        dense: points by stereo [N, 3], some beside the surface, and seen: a view (of the scene) that saw each.
        pixel: size of a pixel at the building.
    """

    mesh: Mesh
    sure: NDArray[np.float32]
    dense: NDArray[np.float64]
    seen: NDArray[np.int64]
    pixel: float


def start_surface(
    scene: Scene,
    masks: MaskSet,
    indices: Sequence[int],
    reporter: Reporter,
    threads: int = 0,
    options: StartOptions = StartOptions(),  # frozen
    times: PartTimes | None = None,
) -> StartSurface:
    """The surface that the photos ``indices`` and their masks speak for.

    Args:
        times: where to note what the parts of the work take.

    Raises:
        BadInput: too few edges and points for a surface, or masks without a place in common.
        Cancelled: the user asked to stop.
    """
    threads, times = threads or cores(), times or PartTimes()
    with times.part("views"):
        views = start_views(scene, masks, indices, options.views)
    reporter.check()
    with times.part("lines"):
        lines = find_lines(find_segments(views, options.segments, threads))
    reporter.check()
    with times.part("dense"):
        dense = dense_points(views, masks, options.dense, options.smoothing, threads, reporter.check)
    with times.part("planes"):
        evidence = gather(views, lines, dense, options)
    reporter.check()
    with times.part("cut"):
        mesh, bits = cut_surface(views, evidence, options.cut, reporter.check)
    if not len(mesh.faces):
        raise BadInput("Masks and photos give no starting surface; check the masks and the cameras.")
    first = np.array([views.indices[s[0]] for s in dense.seen], np.int64)
    return StartSurface(mesh, _sure(bits, evidence.strength), dense.points, first, views.pixel)


def gather(views: StartViews, lines: Sequence[Line], dense: DensePoints, options: StartOptions) -> Evidence:
    """All points the surface may pass: on lines, sparse, dense; on planes and creases those that only shape it.

    Raises:
        BadInput: hardly any.
    """
    o, pixel = options.planes, views.pixel
    planes = find_planes(lines, pixel, o)
    on_lines, lines_seen = line_points(list(lines), 4 * pixel, pixel)
    one = np.ones(len(on_lines)), np.ones(len(views.points))
    groups = [(on_lines, lines_seen, one[0], o.near), (views.points, views.seen, one[1], 2 * o.near),
              (dense.points, dense.seen, dense.weight, 1.5 * o.near)]  # fmt: skip
    if sum(len(points) for points, *_ in groups) < _LEAST:
        raise BadInput(
            "The photos show too few edges and points on the building for a surface; add photos that overlap more."
        )
    shaping = _shaping(views, planes, lines, dense, options)
    groups += [(points, [np.zeros(0, np.int64)] * len(points), np.zeros(len(points)), o.near) for points in shaping]
    log.info("start: %d planes; points on lines, sparse, dense, creases, planes, behind, apart: %s", len(planes.planes),
             [len(points) for points, *_ in groups])  # fmt: skip
    points = np.concatenate([g[0] for g in groups])
    near = np.concatenate([np.full(len(g[0]), g[3] * pixel) for g in groups])
    weight = np.concatenate([g[2] for g in groups])
    seen = [s for g in groups for s in g[1]]
    points, on = snap(points, planes, near)
    bits = (on.astype(np.uint64) << np.arange(on.shape[1], dtype=np.uint64)).sum(1, dtype=np.uint64)
    return _merged(points, seen, weight, bits, _relative(planes), 0.5 * pixel)


def _shaping(
    views: StartViews, planes: LinePlanes, lines: Sequence[Line], dense: DensePoints, options: StartOptions
) -> list[NDArray[np.float64]]:
    """Points in the hull on creases and planes, behind those by stereo, and coarse ones in all of it.

    Tetrahedra behind the points of a thin part would else reach to the wall behind it and be crossed by rays to that.
    What no photo shows has a volume, too.
    """
    o, pixel = options.planes, views.pixel
    in_hull = lambda p: views.outside_views(p, options.cut.margin, 2) < 2  # noqa: E731
    points, owner = plane_points(planes, lines, dense.points, pixel, o)
    kept = in_hull(points)
    points, owner = points[kept], owner[kept]
    creases = crease_points(planes, points, owner, o.crease * pixel, 1.2 * o.grid * pixel)
    behind = _off_surface(dense, options.cut.off_surface * pixel)
    return [creases[in_hull(creases)], points, behind[in_hull(behind)], _apart(views.cells, [dense.points, points])]


def _off_surface(dense: DensePoints, distance: float) -> NDArray[np.float64]:
    """Points ``distance`` behind those by stereo (as Carr et al. 2001 bound a surface) and as far apart, [N, 3]."""
    if distance <= 0:
        return np.zeros((0, 3))
    points = dense.points - distance * dense.normals
    voxel = np.floor(points / distance).astype(np.int64)
    return points[np.sort(np.unique(voxel, axis=0, return_index=True)[1])]


def _apart(cells: NDArray[np.float64], others: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Every second cell in each direction that has no other point within its size, [N, 3]."""
    if len(cells) < 2:
        return cells
    size = float(np.diff(np.unique(cells[:, 0].round(9))).min(initial=np.inf))
    if not np.isfinite(size):
        return cells
    number = np.round((cells - cells.min(0)) / size).astype(int)
    coarse = cells[(number % 2 == 0).all(1)]
    tree = cKDTree(np.concatenate(others))
    return coarse[tree.query(coarse, distance_upper_bound=2 * size)[0] == np.inf] if tree.n else coarse


def _relative(planes: LinePlanes) -> NDArray[np.float64]:
    """Strengths beside the mean of the strongest, 0..1."""
    if not len(planes.strength):
        return planes.strength
    return np.clip(planes.strength / np.sort(planes.strength)[-_STRONGEST:].mean(), 1e-3, 1)


def _merged(
    points: NDArray[np.float64],
    seen: Sequence[NDArray[np.int64]],
    weight: NDArray[np.float64],
    bits: NDArray[np.uint64],
    strength: NDArray[np.float64],
    size: float,
) -> Evidence:
    """One point per cube of ``size``: the first of each, all their views, the largest weight."""
    key = np.round((points - points.min(0)) / size).astype(np.int64)
    spans = key.max(0) + 1
    _, first, group = np.unique(
        (key[:, 0] * spans[1] + key[:, 1]) * spans[2] + key[:, 2], return_index=True, return_inverse=True
    )
    largest = np.zeros(len(first))
    np.maximum.at(largest, group, weight)
    count = np.array([len(s) for s in seen])
    pair = np.unique(np.repeat(group, count) * 65536 + np.concatenate([np.zeros(0, np.int64), *seen]))
    owner, number = np.divmod(pair, 65536)
    together = np.split(number, np.searchsorted(owner, np.arange(1, len(first))))
    return Evidence(points[first], together, largest, bits[first], strength)


def _sure(bits: NDArray[np.uint64], strength: NDArray[np.float64]) -> NDArray[np.float32]:
    sure = np.zeros(len(bits), np.float32)
    for n, s in enumerate(strength):
        sure = np.maximum(sure, np.where((bits >> np.uint64(n)) & np.uint64(1) == 1, np.float32(s), 0))
    return sure
