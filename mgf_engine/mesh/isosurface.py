# SPDX-License-Identifier: GPL-3.0-or-later
"""Marching tetrahedra: the surface between solid and free points of a tetrahedral mesh (eq. 26).

Faces are oriented from solid to free, outward. All tetrahedra must have positive volume
(``(b - a) x (c - a) . (d - a) > 0``); orientation then follows from the order of their vertices alone, so that even
slivers whose volume rounds to nothing come out right.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.native.parallel import parallel_map

FREE, SOLID, INVALID = 0, 1, 2
NEAR_ENOUGH = 0.02  # absolute signed distance at which root finding ends
PIECE_BITS = 5  # edges are numbered in 2^5 pieces, a few of them at a time in parallel
CHUNK = 1 << 19  # number of tetrahedra or quadrilaterals processed together, which limits the memory
LEAST_STEP = 0.05  # minimum share by which each root-finding step shortens the bracket


@dataclass(frozen=True)
class Crossing:
    """The surface before its vertices are placed on the edges.

    Attributes:
        edges: int32 [E, 2], (solid point, free point) of each crossing edge; one mesh vertex lies on each.
        faces: int32 [F, 3], indices into ``edges``, counter-clockwise seen from the free side.
    """

    edges: NDArray[np.int32]
    faces: NDArray[np.int32]


def _even_orders() -> NDArray[np.int64]:
    """Return, for each pattern of solid corners (bit i: corner i), an even permutation with the solid corners first."""
    table = np.zeros((16, 4), np.int64)
    for code in range(16):
        solid = [i for i in range(4) if code >> i & 1]
        free = [i for i in range(4) if not code >> i & 1]
        for order in itertools.permutations(range(4)):
            swaps = sum(order[i] > order[j] for i in range(4) for j in range(i + 1, 4))
            if swaps % 2 == 0 and set(order[: len(solid)]) == set(solid) and set(order[len(solid) :]) == set(free):
                table[code] = order
                break
    return table


_ORDER = _even_orders()


def march(tetrahedra: NDArray[np.int32], state: NDArray[np.uint8], points: NDArray[np.float64]) -> Crossing:
    """Find the crossing edges of the tetrahedra, and the faces between them (marching tetrahedra).

    Args:
        tetrahedra: int32 [T, 4], positive volume.
        state: uint8 [M], FREE, SOLID or INVALID; tetrahedra with an invalid corner are left out.
        points: float64 [M, 3]; quadrilaterals are cut along the shorter diagonal of their middle points.
    """
    kinds: tuple[list[NDArray[np.int32]], ...] = ([], [], [])  # with one, two and three solid corners
    for begin in range(0, len(tetrahedra), CHUNK):
        ordered, solid = _select_crossing(tetrahedra[begin : begin + CHUNK], state)
        for count, kind in enumerate(kinds, 1):
            kind.append(ordered[solid == count])
    del tetrahedra  # the largest array of the mesh stage; this is its last reference
    one, two, three = (np.concatenate([np.zeros((0, 4), np.int32), *kind]) for kind in kinds)
    del kinds
    triangles = [one[:, [0, 1, 0, 2, 0, 3]].reshape(-1, 3, 2), three[:, [0, 3, 1, 3, 2, 3]].reshape(-1, 3, 2)]
    triangles += _cut(two[:, [0, 2, 0, 3, 1, 3, 1, 2]].reshape(-1, 4, 2), points)
    del one, two, three
    return _number_edges(triangles, len(state))


def _select_crossing(
    tetrahedra: NDArray[np.int32], state: NDArray[np.uint8]
) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
    """Return those with solid and free corners, solid ones first, [C, 4], and how many are solid, [C]."""
    code, kept = np.zeros(len(tetrahedra), np.uint8), np.ones(len(tetrahedra), bool)
    for k in range(4):
        corner = state[tetrahedra[:, k]]
        code |= (corner == SOLID).astype(np.uint8) << k
        kept &= corner != INVALID
    kept &= (code > 0) & (code < 15)
    code = code[kept]
    return np.take_along_axis(tetrahedra[kept], _ORDER[code], 1), np.bitwise_count(code)


def _cut(quads: NDArray[np.int32], points: NDArray[np.float64]) -> list[NDArray[np.int32]]:
    """Cut each quadrilateral of edges into two triangles, [Q, 4, 2] -> two arrays [Q, 3, 2]."""
    turn = np.zeros(len(quads), bool)
    for begin in range(0, len(quads), CHUNK):
        middle = points[quads[begin : begin + CHUNK]].mean(2)
        first = np.linalg.norm(middle[:, 0] - middle[:, 2], axis=1)
        turn[begin : begin + CHUNK] = first > np.linalg.norm(middle[:, 1] - middle[:, 3], axis=1)
    quads[turn] = np.roll(quads[turn], -1, axis=1)
    return [quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]


def _number_edges(triangles: list[NDArray[np.int32]], count: int) -> Crossing:
    """Give each distinct edge (solid, free) of triangles, arrays [F, 3, 2] that are used up, one number.

    Edges are sorted piece after piece of their solid points: all at once would take several times the memory.
    """
    shift, ends = max(0, count.bit_length() - PIECE_BITS), np.cumsum([0, *(3 * len(part) for part in triangles)])
    key, piece = np.empty(ends[-1], np.int64), np.empty(ends[-1], np.uint8)
    for end in ends[:0:-1]:
        edges = triangles.pop().reshape(-1, 2)
        rows = slice(end - len(edges), end)
        piece[rows] = edges[:, 0] >> shift
        np.multiply(edges[:, 0], count, out=key[rows], dtype=np.int64)
        key[rows] += edges[:, 1]

    def distinct(number: int) -> tuple[NDArray[np.intp], NDArray[np.int64], NDArray[np.intp]]:
        place = np.flatnonzero(piece == number)
        return place, *np.unique(key[place], return_inverse=True)

    unique, corner, found = [np.zeros(0, np.int64)], np.empty(len(key), np.int32), 0
    for place, keys, inverse in parallel_map(distinct, range(1 << PIECE_BITS)):
        corner[place] = inverse + found
        unique.append(keys)
        found += len(keys)
    edges = np.stack(np.divmod(np.concatenate(unique), max(count, 1)), 1).astype(np.int32)
    return Crossing(edges, corner.reshape(-1, 3))


def find_level(
    solid: NDArray[np.float64],
    free: NDArray[np.float64],
    signed: Callable[[NDArray[np.float64], float], NDArray[np.floating]],
    steps: int,
) -> NDArray[np.float64]:
    """Find the root of the signed distance on each segment from ``solid`` to ``free``.

    Regula falsi (Illinois variant) while the distance is finite at both ends of the bracket, else bisection.

    Args:
        solid: ends inside the solid, [E, 3].
        free: ends in free space, [E, 3].
        signed: (points [n, 3], share of the work done) -> signed distance [n], negative in the solid; proportional to
            the distance between -1 and 1, beyond that only its sign counts; NaN counts as free.
        steps: maximum number of evaluations per segment.

    Returns:
        Points [E, 3] whose distance is below ``NEAR_ENOUGH``, or the estimate after ``steps`` steps; by bisection it is
        within 2^-(steps + 1) of the segment's length.
    """
    place = np.full(len(solid), 0.5)
    left, last = np.arange(len(solid)), np.full(len(solid), -1)
    end, value = np.tile([0.0, 1.0], (len(solid), 1)), np.tile([-np.inf, np.inf], (len(solid), 1))
    for step in range(steps):
        t = place[left]
        found = signed(solid[left] + t[:, None] * (free[left] - solid[left]), step / steps).astype(np.float64)
        side, row = np.where(found < 0, 0, 1), np.arange(len(left))
        value[row, 1 - side] *= np.where(side == last, 0.5, 1.0)
        end[row, side], value[row, side] = t, np.where(np.abs(found) < 1, found, np.inf * (2 * side - 1))
        place[left] = _estimate_root(end, value)
        done = np.abs(found) < NEAR_ENOUGH
        place[left[done]] = t[done]
        left, last, end, value = left[~done], side[~done], end[~done], value[~done]
    return solid + place[:, None] * (free - solid)


def _estimate_root(end: NDArray[np.float64], value: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the next point of a bracket [n, 2] with values of opposite sign, infinite where only the sign is
    known."""
    known = np.isfinite(value).all(1)
    low, high = np.where(known, value.T, [[-1.0], [1.0]])
    share = np.clip(low / (low - high), LEAST_STEP, 1 - LEAST_STEP)
    return end[:, 0] + share * (end[:, 1] - end[:, 0])
