# SPDX-License-Identifier: GPL-3.0-or-later
"""Reference of ``mgf_delaunay``: Delaunay tetrahedra by their definition, in exact integer arithmetic."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

Whole = Sequence[Sequence[int]]


def reference_delaunay(points: NDArray[np.float64]) -> NDArray[np.int32]:
    """Return the tetrahedra [T, 4] of few points [M, 3] between 0 and 1, as the kernel orders them.

    Those that no other point lies inside the sphere of.
    """
    whole = [[int(x) for x in row] for row in np.rint(points * 2.0**53)]
    found = []
    for corners in combinations(range(len(whole)), 4):
        volume = side(whole, corners)
        others = (p for p in range(len(whole)) if p not in corners)
        if volume and not any(is_inside(whole, corners, p, volume) for p in others):
            found.append(corners if volume > 0 else (*corners[:2], corners[3], corners[2]))
    return np.array(sorted(found), np.int32).reshape(-1, 4)


def side(whole: Whole, corners: Sequence[int]) -> int:
    """Return the sign of the volume of a tetrahedron."""
    a, *others = (whole[corner] for corner in corners)
    return _sign([[x - y for x, y in zip(other, a, strict=True)] for other in others])


def is_inside(whole: Whole, corners: Sequence[int], p: int, volume: int) -> bool:
    """Tell whether point p lies inside a tetrahedron's sphere; on it, as if lower numbers were lowered.

    Lifted to the sum of its squares each point is a corner of a convex hull, whose lower faces are the tetrahedra. A
    point with a lower number is lowered more, by a height that is endlessly small.

    Args:
        whole: coordinates of all points.
        corners: of the tetrahedron.
        p: number of the point.
        volume: sign of the tetrahedron's.
    """
    rows = [[x - y for x, y in zip(whole[corner], whole[p], strict=True)] for corner in corners]
    found = volume * _sign([[*row, sum(x * x for x in row)] for row in rows])
    # Each row's height falls by its own point's amount, less p's: the first that makes a difference decides.
    for lowered in sorted([*corners, p]):
        if found:
            break
        falls = [int(p == lowered) - int(corner == lowered) for corner in corners]
        found = volume * _sign([[*row, fall] for row, fall in zip(rows, falls, strict=True)])
    return found < 0


def _sign(matrix: list[list[int]]) -> int:
    value = _determinant(matrix)
    return (value > 0) - (value < 0)


def _determinant(matrix: list[list[int]]) -> int:
    """Compute a determinant by its first row."""
    if len(matrix) == 1:
        return matrix[0][0]
    return sum(
        (-1) ** k * first * _determinant([row[:k] + row[k + 1 :] for row in matrix[1:]])
        for k, first in enumerate(matrix[0])
    )
