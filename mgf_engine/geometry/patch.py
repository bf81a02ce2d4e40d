# SPDX-License-Identifier: GPL-3.0-or-later
"""Take a patch out of a mesh, split its faces along a rectangle, and put it back changed."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.clean import edge_keys
from mgf_engine.model.topology import half_edges

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class Patch(NamedTuple):
    """A part of a mesh.

    Attributes:
        vertices: [N, 3].
        faces: [F, 3].
        source: the vertex of the whole mesh that each has its values and colour from, [N].
    """

    vertices: Array
    faces: Index
    source: Index


def change_part(patch: Patch, some: NDArray[np.bool_], change: Callable[[Patch], Patch | None]) -> Patch | None:
    """Change a part of a mesh.

    Args:
        patch: the mesh.
        some: the faces that are the part, bool [F].
        change: returns the part with its new vertices after the others, or None.

    Returns:
        The mesh with its new vertices after the others; None if ``change`` returns None.
    """
    used, corner = np.unique(patch.faces[some], return_inverse=True)
    part = change(Patch(patch.vertices[used], corner.reshape(-1, 3), patch.source[used]))
    if part is None:
        return None
    at, old = patch.vertices.copy(), len(used)
    at[used] = part.vertices[:old]
    number = np.concatenate([used, len(at) + np.arange(len(part.vertices) - old)])
    return Patch(
        np.concatenate([at, part.vertices[old:]]),
        np.concatenate([patch.faces[~some], number[part.faces]]),
        np.concatenate([patch.source, part.source[old:]]),
    )


def faces_over_rectangle(at: Array, faces: NDArray[np.integer], low: Array, high: Array) -> NDArray[np.bool_]:
    """Tell which faces overlap a rectangle as seen along z, by their boxes.

    Args:
        at: vertices, [N, 3].
        faces: [F, 3].
        low: least x and y of the rectangle, [2].
        high: largest x and y, [2].

    Returns:
        bool [F].
    """
    return rectangles_overlap(*face_rectangles(at, faces), low, high)


def face_rectangles(at: Array, faces: NDArray[np.integer]) -> tuple[Array, Array]:
    """Return the least and the largest x and y of each face.

    Args:
        at: vertices, [N, 3].
        faces: [F, 3].

    Returns:
        [F, 2], [F, 2].
    """
    a, b, c = (at[faces[:, k], :2] for k in range(3))
    return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)


def rectangles_overlap(lows: Array, highs: Array, low: Array, high: Array) -> NDArray[np.bool_]:
    """Tell which of rectangles overlap another one, bool [n].

    Args:
        lows: least x and y of each, [n, 2].
        highs: largest x and y of each, [n, 2].
        low: least x and y of the other, [2].
        high: its largest x and y, [2].
    """
    below, above = lows < high, highs > low
    return np.asarray(below[:, 0] & below[:, 1] & above[:, 0] & above[:, 1])


def faces_touching(faces: NDArray[np.integer], some: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Tell which of faces [F, 3] have a vertex in common with some of them, bool [F]; edges on these may be divided."""
    chosen = np.zeros(int(faces.max(initial=-1)) + 1, bool)
    chosen[faces[some]] = True
    return np.asarray(chosen[faces].any(1))


def split_along_rectangle(patch: Patch, box: Array, snap: float) -> Patch:
    """Split the faces along the sides of a rectangle as seen along z, so that none lies both within it and beyond.

    Args:
        patch: to split.
        box: left, top, right, bottom of the rectangle, y up, [4].
        snap: distance from a side within which vertices are moved onto it.
    """
    left, top, right, bottom = (float(value) for value in box)
    for axis, value, low, high in (
        (0, left, bottom, top), (0, right, bottom, top), (1, bottom, left, right), (1, top, left, right),
    ):  # fmt: skip
        patch = _split_along_side(patch, axis, value, low, high, snap)
    return patch


def _split_along_side(patch: Patch, axis: int, value: float, low: float, high: float, snap: float) -> Patch:
    """Split the faces that touch an axis-parallel segment, all the way, so that none lies on both its sides.

    Args:
        patch: to split.
        axis: 0 where x has one value on the line, 1 where y has.
        value: that value.
        low: the least of the other coordinate on the segment.
        high: the largest.
        snap: distance within which vertices are moved onto the segment.
    """
    at = patch.vertices.copy()
    along = at[:, 1 - axis]
    near = (np.abs(at[:, axis] - value) < snap) & (along > low - snap) & (along < high + snap)
    at[near, axis] = value
    off = at[:, axis] - value
    side = np.sign(off)[patch.faces]
    reach = along[patch.faces]
    cut = (side.min(1) < 0) & (side.max(1) > 0) & (reach.min(1) <= high) & (reach.max(1) >= low)
    edges = np.sort(half_edges(patch.faces[cut]), 1)
    edges = np.unique(edges[off[edges[:, 0]] * off[edges[:, 1]] < 0], axis=0)
    if not len(edges):
        return patch._replace(vertices=at)
    a, b = edges.T
    share = (off[a] / (off[a] - off[b]))[:, None]
    new = at[a] + share * (at[b] - at[a])
    new[:, axis] = value
    source = np.where(share[:, 0] < 0.5, patch.source[a], patch.source[b])
    faces = _with_middles(patch.faces, edges, len(at))
    return Patch(np.concatenate([at, new]), faces, np.concatenate([patch.source, source]))


def _with_middles(faces: Index, edges: Index, count: int) -> Index:
    """Divide faces [F, 3] at new vertices on their edges, two edges of a face at most.

    Args:
        faces: of ``count`` vertices.
        edges: those with a new vertex, lower number first, in ascending order, [E, 2]; that of the k-th is count + k.
        count: number of vertices before.
    """
    key, own_key = edges[:, 0] << 32 | edges[:, 1], edge_keys(faces)[0].reshape(-1, 3)
    place = np.minimum(np.searchsorted(key, own_key), len(key) - 1)
    has = key[place] == own_key
    middle = np.where(has, count + place, -1)
    times = has.sum(1)

    def turned(rows: NDArray[np.bool_], first: NDArray[np.int64]) -> tuple[Index, ...]:
        """Return corners a, b, c and the middles of ab, bc, ca of faces whose edge ``first`` is ab."""
        turn = (first[:, None] + np.arange(3)) % 3
        return (*np.take_along_axis(faces[rows], turn, 1).T, *np.take_along_axis(middle[rows], turn, 1).T)

    a, b, c, ab, _, _ = turned(times == 1, has[times == 1].argmax(1))
    one = [np.stack([a, ab, c], 1), np.stack([ab, b, c], 1)]
    a, b, c, _, bc, ca = turned(times == 2, (~has[times == 2]).argmax(1))
    two = [np.stack([c, ca, bc], 1), np.stack([a, b, bc], 1), np.stack([a, bc, ca], 1)]
    return np.concatenate([faces[times == 0], *one, *two])
