# SPDX-License-Identifier: GPL-3.0-or-later
"""Cut openings into the walls of a mesh: a flat bottom, reveals at right angles, and edges that are lines.

Depth maps are blurred at depth discontinuities, so that the mesh slopes into a window over several pixels and rounds
its corners; behind panes that mirror it has caves, handles and holes. What the mesh is within an opening is therefore
not kept: it is removed up to a rectangle around the opening on which it is wall, and the grid of
:mod:`~mgf_engine.mesh.opening_grid` takes its place. Nothing is cut where the mesh is not one sheet along that
rectangle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mgf_engine.geometry.clean import edge_keys, face_neighbours
from mgf_engine.geometry.components import label_components
from mgf_engine.geometry.patch import (
    Patch,
    change_part,
    face_rectangles,
    faces_touching,
    rectangles_overlap,
    split_along_rectangle,
)
from mgf_engine.mesh.extend_planes import ON_PLANE
from mgf_engine.mesh.opening_grid import HeightMap, OpeningGrid, around_rectangle, height_map, opening_grid
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.topology import half_edges
from mgf_engine.openings.wall_frame import WallFrame
from mgf_engine.options.algorithms import parameter

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class OpeningCutOptions:
    """Options of cutting openings into a mesh."""

    margins: tuple[float, float, float, float, float] = parameter(
        (5.0, 8.0, 12.0, 3.0, 2.0), "Distances from an opening at which the mesh may be wall again; the first at "
        "which it is counts", "ground px", low=0.5,
    )  # fmt: skip
    behind: float = parameter(1.5, "Maximum distance behind the plane at which the mesh is wall", "ground px")
    before: float = parameter(6.0, "Maximum distance before the plane of what the wall has around an opening, as sills",
                              "ground px")  # fmt: skip
    reach: float = parameter(40.0, "Distance from a wall up to which the mesh is looked at", "ground px")
    pocket: float = parameter(60.0, "Maximum extent of a pocket of the mesh behind the wall beside an opening, and "
                              "behind its plane", "ground px")  # fmt: skip
    least_depth: float = parameter(0.7, "Minimum depth of an opening", "ground px")
    gap: float = parameter(2.0, "Width of holes of the mesh along that rectangle that are bridged", "ground px")
    folds: float = parameter(
        0.5, "Maximum length of folds of the mesh along the rectangle around an opening, in its sides"
    )
    snap: float = parameter(0.05, "Distance from a line of a cut within which vertices are moved onto it", "ground px")


class WallOpenings(NamedTuple):
    """The openings of a wall.

    Attributes:
        frame: of the wall, unit: a ground pixel.
        boxes: left, top, right, bottom of each, y up; the top is that of the crown, [K, 4].
        depths: of their bottoms behind the wall, [K]; infinite for passages, which are not cut.
        rises: of their arched heads; 0 for level ones, [K].
    """

    frame: WallFrame
    boxes: Array
    depths: Array
    rises: Array


def cut_openings(
    mesh: Mesh, walls: Sequence[WallOpenings], options: OpeningCutOptions = OpeningCutOptions()
) -> tuple[Mesh, int]:
    """Cut openings into a mesh; return it and the number of openings that were cut.

    Args:
        mesh: normalised frame; vertices that are moved or new get the value ``ON_PLANE``.
        walls: with openings.
        options: limits.
    """
    count, total = len(mesh.vertices), 0
    patch = Patch(mesh.vertices, mesh.faces.astype(np.int64), np.arange(count))
    for wall in walls:
        patch, cut = _cut_in_wall(patch, wall, options)
        total += cut
    if not total:
        return mesh, 0
    on_plane = np.ones(len(patch.vertices), np.uint8)
    still = (patch.vertices[:count] == mesh.vertices).all(1)
    on_plane[:count][still] = mesh.values[ON_PLANE][still] if ON_PLANE in mesh.values else 0
    used, corner = np.unique(patch.faces, return_inverse=True)
    result = mesh.gather(patch.source[used], corner.reshape(-1, 3))
    return replace(result, vertices=patch.vertices[used], values={**result.values, ON_PLANE: on_plane[used]}), total


def _cut_in_wall(patch: Patch, wall: WallOpenings, options: OpeningCutOptions) -> tuple[Patch, int]:
    """Cut the openings of a wall into a mesh in its own coordinates; return it and the number of those cut."""
    at = wall.frame.coordinates(patch.vertices)
    near = np.zeros(len(patch.faces), bool)
    rows = np.flatnonzero(((at[:, 2] < options.reach) & (at[:, 2] > -options.pocket))[patch.faces].all(1))
    near[rows] = _near_openings(at, patch.faces[rows], wall.boxes, options)
    cut = 0

    def cut_each(part: Patch) -> Patch:
        nonlocal cut
        before = wall.frame.coordinates(part.vertices)
        now = part._replace(vertices=before)
        for box, depth, rise in zip(wall.boxes, wall.depths, wall.rises, strict=True):
            done = cut_opening(now, box, float(depth), float(rise), options)
            now, cut = (now, cut) if done is None else (done, cut + 1)
        result = wall.frame.points(now.vertices)
        still = (now.vertices[: len(before)] == before).all(1)
        result[: len(before)][still] = part.vertices[still]  # to the bit
        return now._replace(vertices=result)

    result = change_part(patch, faces_touching(patch.faces, near), cut_each)
    return (patch if result is None else result), cut


def cut_opening(
    patch: Patch, box: Array, depth: float, rise: float = 0.0, options: OpeningCutOptions = OpeningCutOptions()
) -> Patch | None:
    """Cut one opening; None where the mesh around it is not one sheet. New vertices come after those of the patch.

    Args:
        patch: faces over the opening and around it, coordinates of the wall.
        box: left, top, right, bottom, y up, ground pixels, [4].
        depth: of its bottom behind the wall, ground pixels.
        rise: of its arched head, ground pixels; 0 for a level one.
        options: limits.
    """
    if not options.least_depth <= depth < np.inf:
        return None
    near = faces_touching(patch.faces, _near_openings(patch.vertices, patch.faces, box[None], options))
    heights = height_map(patch.vertices, patch.faces[near], _widened(box, [max(options.margins)] * 4), options.before)
    margins = _margins(heights, box, options)
    if margins is None:
        return None
    outer = _widened(box, margins)

    def cut(part: Patch) -> Patch | None:
        divided = split_along_rectangle(part, outer, options.snap)
        inside = _inside(divided, outer, options)
        if inside is None:
            return None
        inside = _with_pockets(divided, inside, outer, options)
        seam = _seam(divided, inside, outer, options)
        return None if seam is None else _joined(divided, inside, seam, opening_grid(box, outer, depth, heights, rise))

    return change_part(patch, near, cut)


def _near_openings(at: Array, faces: Index, boxes: Array, options: OpeningCutOptions) -> NDArray[np.bool_]:
    """Tell which faces are wall around openings [K, 4], or behind the wall and within reach of their pockets, [F]."""
    low, high = face_rectangles(at, faces)
    behind = np.flatnonzero((at[:, 2] < -options.behind)[faces].all(1))
    low_behind, high_behind = low[behind], high[behind]
    near = np.zeros(len(faces), bool)
    for box in boxes:
        near |= rectangles_overlap(low, high, *_corners(_widened(box, [max(options.margins)] * 4)))
        reached = rectangles_overlap(low_behind, high_behind, *_corners(_widened(box, [options.pocket] * 4)))
        near[behind[reached]] = True
    return near


def _widened(box: Array, margins: Sequence[float]) -> Array:
    """Return a box [left, top, right, bottom] that is wider by margins at each side."""
    return np.asarray(box + np.array([-1, 1, 1, -1]) * np.array(margins))


def _corners(box: Array) -> tuple[Array, Array]:
    """Return the least and the largest x and y of a box [left, top, right, bottom]."""
    return box[[0, 3]], box[[2, 1]]


def _margins(heights: HeightMap, box: Array, options: OpeningCutOptions) -> list[float] | None:
    """Find how far from each side of an opening the mesh is wall, ground pixels [4]; None where it is none."""
    result = []
    for side in range(4):
        lowest, highest = np.empty(len(options.margins)), np.empty(len(options.margins))
        for k, margin in enumerate(options.margins):
            line = _widened(box, [margin if other == side else 0.0 for other in range(4)])
            ends = np.array(_corners(line))
            ends[:, side % 2] = line[side]
            z = heights.at(ends[0] + np.linspace(0, 1, 40)[:, None] * (ends[1] - ends[0]))
            lowest[k], highest[k] = z.min(), z.max()  # NaN where there is no mesh
        even = (lowest > -options.behind) & (highest < options.behind)
        some = even if even.any() else lowest > -2 * options.behind
        if not some.any():
            return None
        result.append(options.margins[int(some.argmax())])
    return result


def _inside(patch: Patch, outer: Array, options: OpeningCutOptions) -> Index | None:
    """Return the faces of a wall within a rectangle that hang together, numbers [K]; None where there are none.

    Small parts that float behind the wall and reach no side of the rectangle are among them.
    """
    left, top, right, bottom = outer
    x, y, z = patch.vertices.T
    within = (x >= left) & (x <= right) & (y >= bottom) & (y <= top) & (z <= options.before)
    rows = np.flatnonzero(within[patch.faces].all(1))
    if not len(rows):
        return None
    pairs = face_neighbours(patch.faces[rows])
    part = label_components(len(rows), pairs[:, 0], pairs[:, 1])
    area = np.bincount(part, np.abs(_flat_areas(patch.vertices, patch.faces[rows])))
    sides = (patch.vertices[:, [0, 1, 0, 1]] == outer[[0, 3, 2, 1]]).any(1)
    stays = np.bincount(part, (sides | (z > 0))[patch.faces[rows]].any(1)) > 0
    return np.asarray(rows[((np.arange(len(area)) == area.argmax()) | ~stays)[part]])


def _with_pockets(patch: Patch, inside: Index, outer: Array, options: OpeningCutOptions) -> Index:
    """Return the faces to remove with those of pockets: what else hangs on them, and is behind the wall all over.

    Args:
        patch: divided along the rectangle.
        inside: the faces within the rectangle to remove, numbers [K].
        outer: left, top, right, bottom of the rectangle.
        options: limits.
    """
    rest = np.delete(np.arange(len(patch.faces)), inside)
    pairs = face_neighbours(patch.faces[rest])
    part = label_components(len(rest), pairs[:, 0], pairs[:, 1])
    low, high = _corners(_widened(outer, [options.pocket] * 4))
    hidden = (patch.vertices[:, 2] < -options.behind) & (patch.vertices[:, 2] > -options.pocket)
    hidden &= (patch.vertices[:, :2] > low).all(1) & (patch.vertices[:, :2] < high).all(1)
    own = np.zeros(len(patch.vertices), bool)
    own[patch.faces[inside]] = True
    hangs = np.bincount(part, own[patch.faces[rest]].any(1)) > 0
    stays = np.bincount(part, ~hidden[patch.faces[rest]].all(1)) > 0
    return np.concatenate([inside, rest[(hangs & ~stays)[part]]])


def _seam(patch: Patch, inside: Index, outer: Array, options: OpeningCutOptions) -> Index | None:
    """Return the vertices at which what is removed meets what stays, counter-clockwise from the rectangle's lower left
    corner, [S]; None unless they go once along the rectangle, on the wall.

    Args:
        patch: divided along the rectangle.
        inside: the faces to remove.
        outer: left, top, right, bottom of the rectangle.
        options: limits.
    """
    rest = np.delete(patch.faces, inside, axis=0)
    edges = half_edges(patch.faces[inside])
    seam = edges[np.isin(edge_keys(patch.faces[inside])[0], edge_keys(rest)[0])]
    sides = patch.vertices[:, [0, 1, 0, 1]] == outer[[0, 3, 2, 1]]  # left, bottom, right, top
    if not len(seam) or not sides[seam].all(1).any(1).all() or len(np.unique(seam[:, 0])) < len(seam):
        return None
    if patch.vertices[seam, 2].min() < -2 * options.behind:
        return None
    following = dict(seam.tolist())
    _bridge(following, patch.vertices, options.gap)
    loop = [int(seam[np.argmin(np.abs(patch.vertices[seam[:, 0], :2] - outer[[0, 3]]).sum(1)), 0])]
    while len(loop) < len(following) and following.get(loop[-1]) not in (None, loop[0]):
        loop.append(following[loop[-1]])
    along = around_rectangle(patch.vertices[loop, :2], outer)
    once = len(loop) == len(following) and following.get(loop[-1]) == loop[0] and along[0] == 0
    backward = np.clip(-np.diff(along), 0, None).sum()  # folds of the mesh
    return np.array(loop) if once and backward <= options.folds else None


def _bridge(following: dict[int, int], at: Array, gap: float) -> None:
    """Add to a seam, vertex -> the next one, where holes of the mesh interrupt it by less than a gap."""
    first, second = set(following), set(following.values())
    begins = sorted(first - second)
    for end in sorted(second - first):
        away = np.linalg.norm(at[begins] - at[end], axis=1) if begins else np.array([np.inf])
        if away.min() <= gap:
            following[end] = begins.pop(int(away.argmin()))


def _joined(divided: Patch, inside: Index, seam: Index, grid: OpeningGrid) -> Patch:
    """Put the grid of an opening in the place of faces.

    Args:
        divided: the patch, divided along the rectangle around the opening.
        inside: the faces to remove.
        seam: the vertices to join the grid with.
        grid: of the opening.
    """
    start = len(divided.vertices)
    number = np.concatenate([start + np.arange(len(grid.vertices)), seam[::-1]])  # -1 - k is the k-th of the seam
    join = number[grid.join(around_rectangle(divided.vertices[seam, :2], grid.outer))]
    return Patch(
        np.concatenate([divided.vertices, grid.vertices]),
        np.concatenate([np.delete(divided.faces, inside, axis=0), start + grid.faces, join]),
        np.concatenate([divided.source, divided.source[cKDTree(divided.vertices).query(grid.vertices)[1]]]),
    )


def _flat_areas(at: Array, faces: Index) -> Array:
    """Return the areas of faces as seen along the wall's normal, below 0 for those that face away, [F]."""
    a, b, c = (at[faces[:, k], :2] for k in range(3))
    return np.asarray(((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2)
