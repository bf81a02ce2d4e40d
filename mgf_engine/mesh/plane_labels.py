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
from mgf_engine.geometry.components import label_components
from mgf_engine.geometry.normals import vertex_normals
from mgf_engine.mesh.near_planes import Index, NearPlanes, join_ranges, near_planes
from mgf_engine.mesh.photo_consistency import PatchPhotos, compare_patches, widest_angle
from mgf_engine.mesh.plane_detection import Planes
from mgf_engine.model.mesh import Mesh
from mgf_engine.options.algorithms import parameter

Array = NDArray[np.float64]
_PIECE = 300_000  # pairs of a label and a neighbour at a time: some 50 MB


@dataclass(frozen=True)
class PlaneLabelOptions:
    """Options of the labels; costs are per square ground pixel."""

    reach: float = parameter(6.0, "Maximum distance of a vertex from its plane", "ground px")
    rings: int = parameter(20, "Maximum number of edges between a vertex and the faces that the plane was found on")
    trusted_distance: float = parameter(1.0, "Distance from the plane up to which photos are not compared", "ground px")
    largest_area: float = parameter(
        9.0, "Maximum area of a vertex that counts, so that none decides alone", "ground px²"
    )
    no_plane_cost: float = parameter(0.1, "Cost of a vertex without plane")
    distance_cost: float = parameter(0.1, "Cost of the maximum distance from the plane")
    small_plane_cost: float = parameter(0.1, "Cost of a plane that is small or noisy")
    small_area: float = parameter(4000.0, "Area below which a plane is small", "ground px²")
    large_noise: float = parameter(0.5, "Standard deviation from which a plane is noisy", "ground px", low=1e-3)
    sure_area: float = parameter(20000.0, "Area from which on a plane counts as less noisy, in inverse proportion",
                                 "ground px²")  # fmt: skip
    contrast: float = parameter(8.0, "Standard deviation of a patch that makes the photos sure", "grey levels", low=0.1)
    margin: float = parameter(
        0.3, "Correlation by which the plane must be better where the photos are sure, beyond creases", high=1
    )
    sure_parallax: float = parameter(
        1.5, "Parallax between vertex and plane from which on the margin is asked for in full", "px", low=1e-3
    )
    crease: float = parameter(30.0, "Minimum angle between two planes that meet in a crease", "degrees")
    crease_reach: float = parameter(
        3.0, "Distance from both planes up to which a vertex is at their crease", "ground px"
    )
    beyond_cost: float = parameter(1.0, "Cost of each ground pixel beyond the crease with another plane")
    beyond_noise: float = parameter(0.5, "Distance beyond a crease that costs nothing", "ground px")
    side_reach: float = parameter(30.0, "Distance from a plane up to which it is asked on which side another lies",
                                  "ground px")  # fmt: skip
    side: float = parameter(0.9, "Minimum share of such vertices on one side", high=1)
    step_cost: float = parameter(0.2, "Cost of an edge whose ends have different labels, a step apart")
    full_step: float = parameter(2.0, "Distance between the places of two labels that costs a full step", "ground px")
    facing: float = parameter(-0.2, "Minimum cosine between a vertex's normal and the plane's", low=-1.0, high=1)
    island_area: float = parameter(100.0, "Area up to which vertices without plane go into the plane around them",
                                   "ground px²")  # fmt: skip
    island_height: float = parameter(2.5, "Maximum distance of such vertices from that plane", "ground px")
    rounds: int = parameter(10, "Number of rounds of iterated conditional modes")


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
    counted = np.minimum(area, options.largest_area)
    cost = counted[candidates.near.vertex] * _plane_costs(mesh, pixel, planes, photos, candidates, options)
    label = _choose(mesh, pixel, planes, candidates.near, cost, counted * options.no_plane_cost, options)
    label = drop_islands(mesh, area, label, flat, options)
    return fill_islands(mesh, pixel, area, planes, label, flat, options)


def drop_islands(
    mesh: Mesh,
    area: Array,
    label: NDArray[np.int32],
    flat: NDArray[np.int32],
    options: PlaneLabelOptions = PlaneLabelOptions(),
) -> NDArray[np.int32]:
    """Take the labels of small groups in one plane where flattening moved most of them into another plane.

    Their neighbours have no label and stay in that plane, a pixel or two from the group: teeth on a flat wall.

    Args:
        mesh: its faces.
        area: a third of that of the faces around each vertex, in square ground pixels, [N].
        label: the plane of each vertex, [N], -1 for none.
        flat: the plane that flattening moved each vertex into, [N], -1 for none.
        options: how small.

    Returns:
        The labels without those of the groups, [N].
    """
    known = np.where(label >= 0, label, flat)
    start, neighbour = mesh.adjacency.neighbours()
    vertex = np.repeat(np.arange(len(known)), np.diff(start))
    same = known[vertex] == known[neighbour]
    group = label_components(len(known), vertex[same], neighbour[same])
    count = int(group.max(initial=-1)) + 1
    elsewhere = (label >= 0) & (flat >= 0) & (flat != label)
    small = np.bincount(group, area, count) < options.island_area
    most = 2 * np.bincount(group, elsewhere, count) > np.bincount(group, minlength=count)
    return np.where((small & most)[group], np.int32(-1), label)


def fill_islands(
    mesh: Mesh,
    pixel: Array,
    area: Array,
    planes: Planes,
    label: NDArray[np.int32],
    flat: NDArray[np.int32],
    options: PlaneLabelOptions = PlaneLabelOptions(),
) -> NDArray[np.int32]:
    """Give small and low groups of vertices without plane the most frequent plane around them.

    The planes around them must be nearly parallel; a group between others, such as a crease, stays.

    Args:
        mesh: normalised frame.
        pixel: size of a ground pixel at each vertex, [N].
        area: a third of that of the faces around each vertex, in square ground pixels, [N].
        planes: found on this mesh.
        label: the plane of each vertex, [N], -1 for none.
        flat: the plane that flattening moved each vertex into, [N], -1 for none.
        options: how small and how low.

    Returns:
        The labels with those of the groups, [N].
    """
    known = np.where(label >= 0, label, flat)
    free = known < 0
    group, around, plane = _islands(mesh, known)
    count = int(group.max(initial=-1)) + 1
    frequent = _most_frequent(around, plane, count, len(planes.normals))
    total = np.bincount(around, minlength=count)
    sums = np.stack([np.bincount(around, planes.normals[plane, k], count) for k in range(3)], 1)
    parallel = np.linalg.norm(sums, axis=1) > np.cos(np.radians(options.crease / 4)) * np.maximum(total, 1)
    small = np.bincount(group, area, count) < options.island_area
    rows = np.flatnonzero(free & (parallel & (total > 0) & small)[group])
    own = frequent[group[rows]]
    height = np.zeros(count)
    np.maximum.at(height, group[rows], np.abs(planes.distances(mesh.vertices[rows], own)) / pixel[rows])
    low = height[group[rows]] < options.island_height
    filled = label.copy()
    filled[rows[low]] = own[low]
    return filled


def _islands(mesh: Mesh, label: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int32], Index]:
    """Group connected vertices without plane.

    Returns:
        The group of each vertex [N], those with a plane alone in theirs; and of each edge between a group and a plane
        the group and the plane, [E] each.
    """
    start, neighbour = mesh.adjacency.neighbours()
    vertex, free = np.repeat(np.arange(len(label)), np.diff(start)), label < 0
    inside, rim = free[vertex] & free[neighbour], free[vertex] & ~free[neighbour]
    group = label_components(len(label), vertex[inside], neighbour[inside])
    return group, group[vertex[rim]], label[neighbour[rim]].astype(np.int64)


def _most_frequent(group: NDArray[np.integer], plane: Index, groups: int, planes: int) -> NDArray[np.int32]:
    """Return the most frequent plane of each group, of pairs [E], int32 [groups]; -1 for groups without."""
    keys, times = np.unique(group.astype(np.int64) * planes + plane, return_counts=True)
    order = np.argsort(times, kind="stable")
    frequent = np.full(groups, -1, np.int32)
    frequent[keys[order] // planes] = keys[order] % planes  # the last one written stays
    return frequent


def _candidates(mesh: Mesh, pixel: Array, planes: Planes, options: PlaneLabelOptions) -> _Candidates:
    """Return the planes that each vertex may get; none that it faces away from."""
    near, normals = near_planes(mesh, pixel, planes, options.reach, options.rings), vertex_normals(mesh)
    kept = np.einsum("ij,ij->i", normals[near.vertex], planes.normals[near.plane]) > options.facing
    near = NearPlanes(near.vertex[kept], near.plane[kept])
    shift = planes.distances(mesh.vertices[near.vertex], near.plane)
    place = mesh.vertices[near.vertex] - shift[:, None] * planes.normals[near.plane]
    return _Candidates(near, place, np.abs(shift) / pixel[near.vertex], normals)


def _plane_costs(
    mesh: Mesh, pixel: Array, planes: Planes, photos: PatchPhotos, candidates: _Candidates, options: PlaneLabelOptions
) -> Array:
    """Return what each pair costs per square ground pixel, [K]."""
    near = candidates.near
    areas = np.maximum(planes.area, 1e-12)
    noisy = planes.noise / options.large_noise * np.minimum(options.sure_area / areas, 1)
    poor = np.clip(np.maximum(options.small_area / areas, noisy), 0, 1)
    beyond = _beyond_creases(mesh, pixel, planes, candidates, 1 - poor, options)
    return (
        _photo_costs(mesh, pixel, planes, photos, candidates, options)
        + options.distance_cost * candidates.off / max(options.reach, 1e-12)
        + options.small_plane_cost * poor[near.plane]
        + options.beyond_cost * beyond
    )


def _photo_costs(
    mesh: Mesh, pixel: Array, planes: Planes, photos: PatchPhotos, candidates: _Candidates, options: PlaneLabelOptions
) -> Array:
    """Return the loss of correlation from a vertex to its projection, where photos have contrast, [K]."""
    cost = np.zeros(len(candidates.off))
    asked = np.flatnonzero(candidates.off > options.trusted_distance)
    vertex, plane = candidates.near.vertex[asked], candidates.near.plane[asked]
    own, index = np.unique(vertex, return_inverse=True)
    here, contrast = compare_patches(photos, own, mesh.vertices[own], candidates.normals[own], pixel[own])
    there, other = compare_patches(photos, vertex, candidates.place[asked], planes.normals[plane], pixel[vertex])
    sure = np.minimum(np.maximum(contrast[index], other) / options.contrast, 1)
    margin = np.where(_at_creases(planes, candidates, options)[vertex], 0.0, options.margin) * np.clip(
        candidates.off[asked] - options.trusted_distance, 0, 1
    )
    # Where all photos look from nearly the same side, a dent and a reveal look alike, and the plane is simpler.
    parallax = candidates.off[asked] * 2 * np.tan(widest_angle(photos, mesh.vertices, own)[index] / 2)
    margin *= np.minimum(parallax / options.sure_parallax, 1)
    cost[asked] = sure * (here[index] - there + margin)
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
