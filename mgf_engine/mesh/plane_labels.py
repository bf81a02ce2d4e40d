# SPDX-License-Identifier: GPL-3.0-or-later
"""Label each vertex of a mesh with a plane or none, by photo-consistency.

At a dent in a plain wall or a rounded edge between two walls, the photos have no texture: there a plane is the simplest
explanation. Where they have contrast, they must correlate on the plane as well as at the vertex. The cost of the labels
also penalises steps between neighbours; it is minimised by iterated conditional modes (Besag, *On the statistical
analysis of dirty pictures*, 1986).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.clean import vertex_areas
from mgf_engine.geometry.normals import vertex_normals
from mgf_engine.mesh.near_planes import Index, NearPlanes, join_ranges, near_planes
from mgf_engine.mesh.photo_consistency import PatchPhotos, compare_patches, widest_angle
from mgf_engine.mesh.plane_detection import Planes
from mgf_engine.mesh.plane_islands import drop_islands, fill_islands, fill_plain_bumps
from mgf_engine.mesh.plane_label_options import PlaneLabelOptions
from mgf_engine.model.mesh import Mesh

Array = NDArray[np.float64]
_PIECE = 300_000  # pairs of a label and a neighbour at a time: some 50 MB


@dataclass(frozen=True)
class _Candidates:
    """Planes that vertices may get.

    Attributes:
        near: pairs of a vertex and a plane, K of them.
        place: the vertices' feet on their planes, [K, 3].
        off: distances from their planes, in ground pixels, [K].
        normals: unit, of all vertices, [N, 3].
    """

    near: NearPlanes
    place: Array
    off: Array
    normals: Array


def label_vertices(
    mesh: Mesh,
    pixel: Array,
    planes: Planes,
    photos: PatchPhotos,
    flat: NDArray[np.int32],
    options: PlaneLabelOptions = PlaneLabelOptions(),
) -> NDArray[np.int32]:
    """Choose the plane of each vertex, int32 [N], -1 for none.

    Args:
        mesh: normalised frame.
        pixel: size of a ground pixel at each vertex, [N].
        planes: found on this mesh.
        photos: what sees its vertices.
        flat: the plane that flattening moved each vertex into, [N], -1 for none.
        options: costs and distances.
    """
    area = vertex_areas(mesh) / pixel**2
    candidates = _candidates(mesh, pixel, planes, options)
    here, contrast = _scores_of_photos(mesh, pixel, photos, candidates, options)
    counted = np.minimum(area, options.largest_area)
    cost = counted[candidates.near.vertex] * (
        _photo_costs(mesh, pixel, planes, photos, candidates, here, contrast, options)
        + _plane_costs(mesh, pixel, planes, candidates, options)
    )
    label = _choose(mesh, pixel, planes, candidates.near, cost, counted * options.no_plane_cost, options)
    label = drop_islands(mesh, area, label, flat, options)
    label = fill_islands(mesh, pixel, area, planes, label, flat, options)
    plain = (contrast <= options.plain_contrast) & (here < options.plain_correlation)
    return fill_plain_bumps(mesh, pixel, np.where(np.isfinite(contrast), area, 0), planes, label, flat, plain, options)


def _candidates(mesh: Mesh, pixel: Array, planes: Planes, options: PlaneLabelOptions) -> _Candidates:
    """Return the planes that each vertex may get; none that it faces away from."""
    normals = vertex_normals(mesh)
    near = near_planes(mesh, pixel, planes, options.reach, options.rings)
    kept = np.einsum("ij,ij->i", normals[near.vertex], planes.normals[near.plane]) > options.facing
    near = NearPlanes(near.vertex[kept], near.plane[kept])
    shift = planes.distances(mesh.vertices[near.vertex], near.plane)
    place = mesh.vertices[near.vertex] - shift[:, None] * planes.normals[near.plane]
    return _Candidates(near, place, np.abs(shift) / pixel[near.vertex], normals)


def _plane_costs(
    mesh: Mesh, pixel: Array, planes: Planes, candidates: _Candidates, options: PlaneLabelOptions
) -> Array:
    """Return what each pair costs per square ground pixel besides what photos say, [K]."""
    near = candidates.near
    areas = np.maximum(planes.area, 1e-12)
    noisy = planes.noise / options.large_noise * np.minimum(options.sure_area / areas, 1)
    poor = np.clip(np.maximum(options.small_area / areas, noisy), 0, 1)
    beyond = _beyond_creases(mesh, pixel, planes, candidates, 1 - poor, options)
    return (
        options.distance_cost * candidates.off / max(options.reach, 1e-12)
        + options.small_plane_cost * poor[near.plane]
        + options.beyond_cost * beyond
    )


def _scores_of_photos(
    mesh: Mesh, pixel: Array, photos: PatchPhotos, candidates: _Candidates, options: PlaneLabelOptions
) -> tuple[Array, Array]:
    """Return correlation and contrast of the photos at each vertex, [N] each; NaN where no plane is far enough off."""
    here, contrast = np.full(len(pixel), np.nan), np.full(len(pixel), np.nan)
    own = np.unique(candidates.near.vertex[candidates.off > options.trusted_distance])
    here[own], contrast[own] = compare_patches(photos, own, mesh.vertices[own], candidates.normals[own], pixel[own])
    return here, contrast


def _photo_costs(
    mesh: Mesh,
    pixel: Array,
    planes: Planes,
    photos: PatchPhotos,
    candidates: _Candidates,
    here: Array,
    contrast: Array,
    options: PlaneLabelOptions,
) -> Array:
    """Return the loss of correlation from a vertex to its projection, where photos have contrast, [K]."""
    cost = np.zeros(len(candidates.off))
    asked = np.flatnonzero(candidates.off > options.trusted_distance)
    vertex, plane = candidates.near.vertex[asked], candidates.near.plane[asked]
    own, index = np.unique(vertex, return_inverse=True)
    there, other = compare_patches(photos, vertex, candidates.place[asked], planes.normals[plane], pixel[vertex])
    sure = np.minimum(np.maximum(contrast[vertex], other) / options.contrast, 1)
    margin = np.where(_at_creases(planes, candidates, options)[vertex], 0.0, options.margin) * np.clip(
        candidates.off[asked] - options.trusted_distance, 0, 1
    )
    # Where all photos look from nearly the same side, a dent and a reveal look alike, and the plane is simpler.
    parallax = candidates.off[asked] * 2 * np.tan(widest_angle(photos, mesh.vertices, own)[index] / 2)
    margin *= np.minimum(parallax / options.sure_parallax, 1)
    cost[asked] = sure * (here[vertex] - there + margin)
    return cost


def _at_creases(planes: Planes, candidates: _Candidates, options: PlaneLabelOptions) -> NDArray[np.bool_]:
    """Tell which vertices are near two planes that meet at an angle, bool [at least the largest vertex + 1]."""
    close = candidates.off <= options.crease_reach
    near = NearPlanes(candidates.near.vertex[close], candidates.near.plane[close])
    result = np.zeros(candidates.near.vertex.max(initial=-1) + 1, bool)
    if len(near.vertex):
        first = np.repeat(near.plane[near.begin[:-1]], np.diff(near.begin))
        cosine = np.einsum("ij,ij->i", planes.normals[first], planes.normals[near.plane])
        result[near.vertex[cosine < np.cos(np.radians(options.crease))]] = True
    return result


def _beyond_creases(
    mesh: Mesh, pixel: Array, planes: Planes, candidates: _Candidates, weight: Array, options: PlaneLabelOptions
) -> Array:
    """Return how far each place lies beyond the crease of its plane with another one near the vertex, [K], in px.

    Worn edges have small planes of their own: each counts by its ``weight`` [P].
    """
    near, side = candidates.near, _crease_signs(mesh, pixel, planes, options)
    result = np.zeros(len(candidates.off))
    if not len(result):
        return result
    count = np.diff(near.begin)
    start, count = np.repeat(near.begin[:-1], count), np.repeat(count, count)
    for turn in range(1, int(count.max())):
        rows = np.flatnonzero(count > turn)
        other = near.plane[start[rows] + (rows - start[rows] + turn) % count[rows]]
        over = (
            -side[near.plane[rows], other] * planes.distances(candidates.place[rows], other) / pixel[near.vertex[rows]]
        )
        result[rows] = np.maximum(result[rows], weight[other] * (over - options.beyond_noise))
    return result


def _crease_signs(mesh: Mesh, pixel: Array, planes: Planes, options: PlaneLabelOptions) -> Array:
    """Return for each two planes -1 where their crease is convex, 1 where it is concave, 0 where neither, [P, P]."""
    count = len(planes.normals)
    own = [np.unique(mesh.faces[planes.label == number]) for number in range(count)]
    side = np.zeros((count, count))
    for number, rows in enumerate(own):
        for other in range(count):
            off = planes.distances(mesh.vertices[rows], np.full(len(rows), other)) / pixel[rows]
            off = off[np.abs(off) < options.side_reach]
            above = float((off > 0).mean()) if len(off) else 0.5
            side[other, number] = (above > options.side) - (above < 1 - options.side)
    meet = planes.normals @ planes.normals.T < np.cos(np.radians(options.crease / 4))
    return np.where(meet & (side == side.T), side, 0.0)


def _choose(
    mesh: Mesh, pixel: Array, planes: Planes, near: NearPlanes, cost: Array, none: Array, options: PlaneLabelOptions
) -> NDArray[np.int32]:
    """Minimise the cost of the labels: ``cost`` [K] of pairs, ``none`` [N] of no plane, and of steps along edges."""
    count = len(none)
    vertex, plane, own = np.r_[np.arange(count), near.vertex], np.r_[np.full(count, -1), near.plane], np.r_[none, cost]
    order = np.argsort(vertex, kind="stable")
    vertex, plane, own = vertex[order], plane[order], own[order]
    begin = np.searchsorted(vertex, np.arange(count))
    label = _cheapest(vertex, plane, own, begin)
    start, neighbour = mesh.adjacency.neighbours()
    random = np.random.default_rng(0)
    for _ in range(options.rounds):
        mixed = np.zeros(count, bool)
        mixed[np.repeat(np.arange(count), np.diff(start))[label[neighbour] != np.repeat(label, np.diff(start))]] = True
        mixed &= random.random(count) < 0.5  # simultaneous changes of two neighbours would only swap their labels
        total = own.copy()
        rows = np.flatnonzero(mixed[vertex])
        for piece in range(0, len(rows), _PIECE):
            some = rows[piece : piece + _PIECE]
            total[some] += _steps(mesh, pixel, planes, (vertex[some], plane[some]), (start, neighbour), label, options)
        new = _cheapest(vertex, plane, total, begin)
        label = np.where(mixed, new, label)
    return label.astype(np.int32)


def _cheapest(vertex: Index, plane: Index, cost: Array, begin: Index) -> Index:
    """Return the plane of least cost of each vertex, [N]; pairs are ordered by vertex."""
    least = np.minimum.reduceat(cost, begin)[vertex] == cost
    rows = np.flatnonzero(least)
    return plane[rows[np.r_[True, vertex[rows][1:] != vertex[rows][:-1]]]]


def _steps(
    mesh: Mesh,
    pixel: Array,
    planes: Planes,
    pairs: tuple[Index, Index],
    neighbours: tuple[Index, Index],
    label: Index,
    options: PlaneLabelOptions,
) -> Array:
    """Return what the steps between pairs (vertex, plane) [K] and the labels of the vertices' neighbours cost, [K]."""
    (vertex, plane), (start, neighbour) = pairs, neighbours
    times = (start[1:] - start[:-1])[vertex]
    row = np.repeat(np.arange(len(vertex)), times)
    other = neighbour[join_ranges(start[vertex], times)]
    unlike = plane[row] != label[other]
    row, other = row[unlike], other[unlike]
    step = np.zeros(len(row))
    for at in (vertex[row], other):
        apart = _places(mesh, planes, at, plane[row]) - _places(mesh, planes, at, label[other])
        step = np.maximum(step, np.linalg.norm(apart, axis=1) / pixel[at])
    sums = np.bincount(row, options.step_cost * np.minimum(step / max(options.full_step, 1e-12), 1), len(vertex))
    return np.asarray(sums, np.float64)


def _places(mesh: Mesh, planes: Planes, vertex: Index, plane: Index) -> Array:
    """Return vertices [K, 3] projected onto their planes; those without stay."""
    at = mesh.vertices[vertex]
    some = np.flatnonzero(plane >= 0)
    at[some] -= planes.distances(at[some], plane[some])[:, None] * planes.normals[plane[some]]
    return np.asarray(at, np.float64)
