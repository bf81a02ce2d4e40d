# SPDX-License-Identifier: GPL-3.0-or-later
"""Cut openings into the walls of a mesh: a flat bottom, reveals at right angles, and edges that are lines.

Depth maps are blurred at depth discontinuities, so that the mesh slopes into a window over several pixels and rounds
its corners. Here its faces are cut along the rectangle of the opening; what lies inside goes to the opening's depth,
the slope outside into the wall, and faces at right angles join the two. No opening is cut where the mesh is not one
sheet over the rectangle, or where its bottom is not flat.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.linalg import spsolve

from mgf_engine.geometry.clean import edges as edge_keys
from mgf_engine.geometry.clean import face_neighbours
from mgf_engine.geometry.components import label_components
from mgf_engine.geometry.normals import unit_vectors
from mgf_engine.mesh.extend_planes import ON_PLANE
from mgf_engine.model.mesh import Mesh
from mgf_engine.openings.wall_frame import WallFrame
from mgf_engine.options.algorithms import parameter

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_AREA = 0.02  # share by which the faces over a rectangle may differ from its area: they are one sheet over it
_UNFOLD_ROUNDS = 3


@dataclass(frozen=True)
class CutOptions:
    """Options of cutting openings into a mesh."""

    slope: float = parameter(5.0, "Distance from an opening up to which the mesh is its slope, and goes into the wall",
                             "ground px")  # fmt: skip
    around: float = parameter(2.0, "Width of what is looked at around that slope", "ground px")
    deeper: float = parameter(1.5, "Distance behind the bottom up to which such a slope may reach", "ground px")
    facing: float = parameter(
        0.3, "Largest cosine between a slope's normal and the direction away from the opening", low=-1, high=1
    )
    snap: float = parameter(0.05, "Distance from an edge of an opening within which vertices are moved onto it",
                            "ground px")  # fmt: skip
    least_depth: float = parameter(0.7, "Minimum depth of the bottom, the median of its middle", "ground px")
    middle: float = parameter(0.2, "Margin around that middle, as a share of the opening's sides", high=0.45)
    uneven: float = parameter(0.75, "Maximum median deviation of that middle from the bottom", "ground px")


class WallOpenings(NamedTuple):
    """The openings of a wall.

    Attributes:
        frame: of the wall, unit: a ground pixel.
        boxes: left, top, right, bottom of each, y up, [K, 4].
        faces: numbers of the faces over and around them, [M].
    """

    frame: WallFrame
    boxes: Array
    faces: Index


class Patch(NamedTuple):
    """A part of a mesh in the coordinates of its wall.

    Attributes:
        at: vertices, ground pixels, [N, 3].
        faces: [F, 3].
        source: the vertex of the mesh that each has its values and colour from, [N].
    """

    at: Array
    faces: Index
    source: Index


def cut_openings(mesh: Mesh, walls: Sequence[WallOpenings], options: CutOptions = CutOptions()) -> tuple[Mesh, int]:
    """Cut openings into a mesh; return it and the number of openings that were cut.

    Args:
        mesh: normalised frame; vertices that are moved get the value ``ON_PLANE``.
        walls: with openings; no face in more than one of them.
        options: limits.
    """
    vertices, on_plane = mesh.vertices.copy(), mesh.values.get(ON_PLANE, np.zeros(len(mesh.vertices), np.uint8)).copy()
    kept, total = np.ones(len(mesh.faces), bool), 0
    more_vertices, more_faces, sources = [], [], []
    count = len(vertices)
    for wall in walls:
        used, corner = np.unique(mesh.faces[wall.faces], return_inverse=True)
        patch = Patch(
            wall.frame.coordinates(vertices[used]), corner.reshape(-1, 3).astype(np.int64), used.astype(np.int64)
        )
        before, cut = patch.at, 0
        for box in wall.boxes:
            done = _cut_in(patch, box, options)
            patch, cut = (patch, cut) if done is None else (done, cut + 1)
        if not cut:
            continue
        old, at = len(used), wall.frame.points(patch.at)
        on_plane[used[(patch.at[:old] != before).any(1)]] = 1
        vertices[used] = at[:old]
        number = np.concatenate([used, count + np.arange(len(at) - old)])
        more_vertices.append(at[old:])
        sources.append(patch.source[old:])
        more_faces.append(number[patch.faces])
        kept[wall.faces] = False
        count, total = count + len(at) - old, total + cut
    if not total:
        return mesh, 0
    whole = np.concatenate([np.arange(len(vertices)), *sources])
    faces = np.concatenate([mesh.faces[kept], *more_faces])
    on_plane = np.concatenate([on_plane, np.ones(count - len(vertices), np.uint8)])
    result = mesh.gather(whole, faces)
    values = {**result.values, ON_PLANE: on_plane}
    return replace(result, vertices=np.concatenate([vertices, *more_vertices]), values=values), total


def _cut_in(patch: Patch, box: Array, options: CutOptions) -> Patch | None:
    """Cut one opening as :func:`cut_rectangle` does, of a large patch, of which only the faces around it matter."""
    left, top, right, bottom = box
    reach = options.slope + options.around
    near = overlapping(patch.at, patch.faces, np.array([left, bottom]) - reach, np.array([right, top]) + reach)
    used, corner = np.unique(patch.faces[near], return_inverse=True)
    part = Patch(patch.at[used], corner.reshape(-1, 3).astype(np.int64), patch.source[used])
    done = cut_rectangle(part, box, options)
    if done is None:
        return None
    at, old = patch.at.copy(), len(used)
    at[used] = done.at[:old]
    number = np.concatenate([used, len(at) + np.arange(len(done.at) - old)])
    return Patch(
        np.concatenate([at, done.at[old:]]),
        np.concatenate([patch.faces[~near], number[done.faces]]),
        np.concatenate([patch.source, done.source[old:]]),
    )


def overlapping(at: Array, faces: NDArray[np.integer], low: Array, high: Array) -> NDArray[np.bool_]:
    """Tell which faces overlap a rectangle as seen along the wall's normal, by their boxes.

    Args:
        at: vertices in coordinates of the wall, [N, 3].
        faces: [F, 3].
        low: least x and y of the rectangle, [2].
        high: largest x and y, [2].

    Returns:
        bool [F].
    """
    result = np.ones(len(faces), bool)
    for axis in (0, 1):
        a, b, c = (at[faces[:, k], axis] for k in range(3))
        result &= np.maximum(np.maximum(a, b), c) > low[axis]
        result &= np.minimum(np.minimum(a, b), c) < high[axis]
    return result


def cut_rectangle(patch: Patch, box: Array, options: CutOptions = CutOptions()) -> Patch | None:
    """Cut one opening; None where the patch is not one sheet over it with a flat bottom.

    New vertices come after those of the patch.

    Args:
        patch: faces over the opening and around it.
        box: left, top, right, bottom, y up, ground pixels, [4].
        options: limits.
    """
    left, top, right, bottom = (float(value) for value in box)
    depth = _depth(patch, box, options)
    if depth is None:
        return None
    patch = _unfold(patch, box, depth, options)
    for axis, value, low, high in (
        (0, left, bottom, top), (0, right, bottom, top), (1, bottom, left, right), (1, top, left, right),
    ):  # fmt: skip
        patch = _split(patch, axis, value, low, high, options.snap)
    inside = _sheet(patch, box)
    if inside is None:
        return None
    rim = _rim(patch, inside, box)
    return None if rim is None else _rebuild(patch, box, inside, rim, depth, options)


def _depth(patch: Patch, box: Array, options: CutOptions) -> float | None:
    """Return how far before the wall (below 0) the flat bottom of an opening lies; None where there is none."""
    left, top, right, bottom = box
    centre, half = np.array([left + right, bottom + top]) / 2, np.array([right - left, top - bottom]) / 2
    middle = (np.abs(patch.at[:, :2] - centre) < (1 - 2 * options.middle) * half).all(1)
    before = patch.at[middle, 2]
    if len(before) < 3:
        return None
    depth = float(np.median(before))
    even = np.median(np.abs(before - depth)) <= options.uneven
    return depth if even and depth <= -options.least_depth else None


def _split(patch: Patch, axis: int, value: float, low: float, high: float, snap: float) -> Patch:
    """Cut the faces that touch a segment of an axis-parallel line, all the way, so that none lies on both its sides.

    Args:
        patch: to cut.
        axis: 0 where x has one value on the line, 1 where y has.
        value: that value.
        low: the least of the other coordinate on the segment.
        high: the largest.
        snap: distance within which vertices are moved onto the segment.
    """
    at = patch.at.copy()
    along = at[:, 1 - axis]
    near = (np.abs(at[:, axis] - value) < snap) & (along > low - snap) & (along < high + snap)
    at[near, axis] = value
    off = at[:, axis] - value
    side = np.sign(off)[patch.faces]
    reach = along[patch.faces]
    cut = (side.min(1) < 0) & (side.max(1) > 0) & (reach.min(1) <= high) & (reach.max(1) >= low)
    edges = np.sort(_edges(patch.faces[cut]), 1)
    edges = np.unique(edges[off[edges[:, 0]] * off[edges[:, 1]] < 0], axis=0)
    if not len(edges):
        return patch._replace(at=at)
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


def _sheet(patch: Patch, box: Array) -> Index | None:
    """Return the connected faces that cover a rectangle once, numbers [K]; None where there are none."""
    left, top, right, bottom = box
    x, y = patch.at[:, 0], patch.at[:, 1]
    rows = np.flatnonzero(((x >= left) & (x <= right) & (y >= bottom) & (y <= top))[patch.faces].all(1))
    if not len(rows):
        return None
    pairs = face_neighbours(patch.faces[rows])
    part = label_components(len(rows), pairs[:, 0], pairs[:, 1])
    areas = np.bincount(part, _flat_areas(patch.at, patch.faces[rows]))
    largest = int(areas.argmax())
    if abs(areas[largest] / ((right - left) * (top - bottom)) - 1) > _AREA:
        return None
    return np.asarray(rows[part == largest])


def _rim(patch: Patch, inside: Index, box: Array) -> Index | None:
    """Return the directed edges [R, 2] around faces over a rectangle; None unless they go once along its border."""
    left, top, right, bottom = box
    faces = patch.faces[inside]
    edges = _edges(faces)
    _, back, times = np.unique(edge_keys(faces)[0], return_inverse=True, return_counts=True)
    rim = edges[times[back] == 1]
    disk = len(np.unique(faces)) - len(times) + len(faces) == 1
    if times.max() > 2 or not disk or len(np.unique(rim[:, 0])) < len(rim):
        return None
    sides = patch.at[:, [0, 1, 0, 1]] == np.array([left, bottom, right, top])
    flat = (sides[faces[:, 0]] & sides[faces[:, 1]] & sides[faces[:, 2]]).any()
    if flat or not sides[rim].any(-1).all():
        return None
    x, y, wide, high = patch.at[:, 0] - left, patch.at[:, 1] - bottom, right - left, top - bottom
    along = np.select(
        [sides[:, 1], sides[:, 2], sides[:, 3]], [x, wide + y, wide + high + wide - x], 2 * wide + high + high - y
    )
    around = 2 * (wide + high)
    step = (along[rim[:, 1]] - along[rim[:, 0]]) % around
    return rim if step.sum() < 1.5 * around else None


def _rebuild(patch: Patch, box: Array, inside: Index, rim: Index, depth: float, options: CutOptions) -> Patch | None:
    """Put what is inside onto the bottom, the slope outside onto the wall, and join them by faces at right angles."""
    border = np.unique(rim)
    within = np.setdiff1d(np.unique(patch.faces[inside]), border)
    at = patch.at.copy()
    if (_flat_areas(at, patch.faces[inside]) <= 0).any():
        at = _harmonic(at, patch.faces[inside], within)
        if (_flat_areas(at, patch.faces[inside]) <= 0).any():
            return None
    outside = np.delete(patch.faces, inside, axis=0)
    slope = _slope(patch, box, outside, border, depth, options)
    at[slope, 2] = at[border, 2] = 0
    at = _unfolded(at, outside[np.isin(outside, slope).any(1)], slope)
    count = len(at)
    copy = np.full(count, -1, np.int64)
    copy[border] = count + np.arange(len(border))
    at = np.concatenate([at, at[border]])
    at[within, 2] = at[copy[border], 2] = depth
    bottom = patch.faces[inside]
    bottom = np.where(copy[bottom] >= 0, copy[bottom], bottom)
    a, b = rim.T
    reveals = [np.stack([copy[b], copy[a], a], 1), np.stack([copy[b], a, b], 1)]
    return Patch(at, np.concatenate([outside, bottom, *reveals]), np.concatenate([patch.source, patch.source[border]]))


def _slope(patch: Patch, box: Array, outside: Index, border: Index, depth: float, options: CutOptions) -> Index:
    """Return the vertices around an opening that lie behind the wall, connected with the opening's border."""
    left, top, right, bottom = box
    at = patch.at
    away = at[:, :2] - np.clip(at[:, :2], [left, bottom], [right, top])
    normals = np.zeros((len(at), 3))
    corner = at[outside]
    np.add.at(normals, outside, np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])[:, None])
    facing = (unit_vectors(normals)[:, :2] * unit_vectors(away)).sum(1)
    slope = (np.linalg.norm(away, axis=1) <= options.slope) & (at[:, 2] < 0) & (at[:, 2] > depth - options.deeper)
    slope &= facing < options.facing
    slope[np.setdiff1d(patch.faces, outside)] = False  # those inside
    slope[border] = True
    a, b = _edges(outside).T
    both = slope[a] & slope[b]
    group = label_components(len(at), a[both], b[both])
    slope &= np.isin(group, group[border])
    slope[border] = False
    return np.flatnonzero(slope)


def _unfold(patch: Patch, box: Array, depth: float, options: CutOptions) -> Patch:
    """Unfold faces of a slope that overhang, so that lines can cut them."""
    left, top, right, bottom = box
    low, high = np.array([left, bottom]) - options.slope, np.array([right, top]) + options.slope
    near = ((patch.at[:, :2] > low) & (patch.at[:, :2] < high)).all(1)
    near &= (patch.at[:, 2] > depth - options.deeper) & (patch.at[:, 2] < 1)
    faces = patch.faces[near[patch.faces].all(1)]
    if not len(faces):
        return patch
    part = label_components(len(near), *_edges(faces).T)[faces[:, 0]]
    faces = faces[part == np.bincount(part).argmax()]  # not what floats before the wall
    return patch._replace(at=_unfolded(patch.at, faces, np.unique(faces)))


def _unfolded(at: Array, faces: Index, free: Index) -> Array:
    """Return vertices [N, 3] of which those of overturned faces were moved along the wall, if that unfolds them."""
    for _ in range(_UNFOLD_ROUNDS):
        over = faces[_flat_areas(at, faces) <= 0]
        if not len(over):
            break
        touched = np.isin(faces, over).any(1)  # and their neighbours
        moving = np.intersect1d(faces[touched], free)
        around = faces[np.isin(faces, moving).any(1)]
        # Vertices on the border of these faces hold the others.
        edges = np.sort(_edges(around), 1)
        own, times = np.unique(edges, axis=0, return_counts=True)
        moving = np.setdiff1d(moving, own[times == 1])
        if not len(moving):
            break
        new = _harmonic(at, around, moving)
        if (_flat_areas(new, faces) <= 0).sum() >= len(over):
            break
        at = new
    return at


def _harmonic(at: Array, faces: Index, free: Index) -> Array:
    """Move vertices along the wall to the means of their neighbours, which overturns no face within a convex border.

    (Tutte, *How to draw a graph*, 1963.)

    Args:
        at: vertices [N, 3]; the others stay.
        faces: around the free ones, [F, 3].
        free: numbers of those that move, [K].
    """
    if not len(free):
        return at
    a, b = np.unique(np.sort(_edges(faces), 1), axis=0).T
    ends = (np.concatenate([a, b]), np.concatenate([b, a]))
    near = sparse.csr_matrix((np.ones(2 * len(a)), ends), (len(at), len(at)))[free]
    degree = np.asarray(near.sum(1)).ravel()
    still = np.ones(len(at), bool)
    still[free] = False
    right = near[:, still] @ at[still, :2]
    result = at.copy()
    result[free, :2] = spsolve((sparse.diags(degree) - near[:, free]).tocsc(), right)
    return result


def _edges(faces: Index) -> Index:
    """Return the edges of faces [F, 3] in their direction, [3 F, 2]."""
    return np.stack([faces.ravel(), np.roll(faces, -1, 1).ravel()], 1)


def _flat_areas(at: Array, faces: Index) -> Array:
    """Return the areas of faces as seen along the wall's normal, below 0 for those that face away, [F]."""
    a, b, c = (at[faces[:, k], :2] for k in range(3))
    return np.asarray(((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2)
