# SPDX-License-Identifier: GPL-3.0-or-later
"""Clear up the labels of planes: groups of vertices that lie apart from the plane around them.

A group without plane that one plane surrounds goes into it where it is small and low, or where photos show nothing
there: only stray points make a bulge on a plain wall. A small group in another plane than the wall around loses it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.components import label_components
from mgf_engine.mesh.near_planes import Index
from mgf_engine.mesh.plane_detection import Planes
from mgf_engine.mesh.plane_label_options import PlaneLabelOptions
from mgf_engine.model.mesh import Mesh

Array = NDArray[np.float64]


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
    islands = _find_islands(mesh, pixel, planes, np.where(label >= 0, label, flat), options)
    small = np.bincount(islands.group, area, len(islands.plane)) < options.island_area
    return islands.fill(label, small & (islands.height < options.island_height))


def fill_plain_bumps(
    mesh: Mesh,
    pixel: Array,
    area: Array,
    planes: Planes,
    label: NDArray[np.int32],
    flat: NDArray[np.int32],
    plain: NDArray[np.bool_],
    options: PlaneLabelOptions = PlaneLabelOptions(),
) -> NDArray[np.int32]:
    """Give bumps on which photos show no texture the plane around them, whatever their area.

    Only stray points and the hull of silhouettes put bumps on a plain wall; a dent may be a dark pane. Vertices that
    were only flattened count as without plane here: a bump may have a small plane of its own.

    Args:
        mesh: normalised frame.
        pixel: size of a ground pixel at each vertex, [N].
        area: around each vertex where photos were compared, in square ground pixels, elsewhere 0, [N].
        planes: found on this mesh.
        label: the plane of each vertex, [N], -1 for none.
        flat: the plane that flattening moved each vertex into, [N], -1 for none.
        plain: where photos show no texture, bool [N].
        options: how high, and how much of a bump may show texture.

    Returns:
        The labels with those of the bumps, [N].
    """
    islands = _find_islands(mesh, pixel, planes, np.where((label >= 0) | plain, label, flat), options)
    count = len(islands.plane)
    textured = np.bincount(islands.group, area * ~plain, count)
    bare = textured < options.bump_texture * np.bincount(islands.group, area, count)
    return islands.fill(label, bare & islands.raised & (islands.height < options.reach))


class _Islands(NamedTuple):
    """Connected groups of vertices without plane, each other vertex in a group of its own.

    Attributes:
        group: of each vertex, [N].
        plane: the most frequent one around each group, [G]; -1 where there is none, or where they are not parallel.
        height: the maximum distance of a group's vertices from its plane, ground pixels, [G].
        raised: whether they lie in front of it on average, bool [G].
    """

    group: NDArray[np.int32]
    plane: NDArray[np.int32]
    height: Array
    raised: NDArray[np.bool_]

    def fill(self, label: NDArray[np.int32], chosen: NDArray[np.bool_]) -> NDArray[np.int32]:
        """Return the labels [N] with the planes of the chosen groups, bool [G]."""
        inside = (chosen & (self.plane >= 0))[self.group]
        return np.where(inside, self.plane[self.group], label)


def _find_islands(
    mesh: Mesh, pixel: Array, planes: Planes, known: NDArray[np.int32], options: PlaneLabelOptions
) -> _Islands:
    """Find the groups of vertices whose ``known`` plane [N] is -1, and the plane around each."""
    group, around, plane = _connected_groups(mesh, known)
    count = int(group.max(initial=-1)) + 1
    frequent = _most_frequent(around, plane, count, len(planes.normals))
    sums = np.stack([np.bincount(around, planes.normals[plane, k], count) for k in range(3)], 1)
    total = np.bincount(around, minlength=count)
    parallel = np.linalg.norm(sums, axis=1) > np.cos(np.radians(options.crease / 4)) * np.maximum(total, 1)
    frequent = np.where(parallel, frequent, np.int32(-1))
    rows = np.flatnonzero((known < 0) & (frequent >= 0)[group])
    above = planes.distances(mesh.vertices[rows], frequent[group[rows]]) / pixel[rows]
    height = np.zeros(count)
    np.maximum.at(height, group[rows], np.abs(above))
    return _Islands(group, frequent, height, np.bincount(group[rows], above, count) > 0)


def _connected_groups(mesh: Mesh, label: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int32], Index]:
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
