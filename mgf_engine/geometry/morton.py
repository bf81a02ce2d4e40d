# SPDX-License-Identifier: GPL-3.0-or-later
"""Morton order (Z-order curve): points that are close in space are close in memory, for better use of the cache."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

BITS = 21  # per axis
_SPREAD = {  # how far bits move apart in each step, and those that are theirs then
    32: 0x1F00000000FFFF, 16: 0x1F0000FF0000FF, 8: 0x100F00F00F00F00F, 4: 0x10C30C30C30C30C3, 2: 0x1249249249249249,
}  # fmt: skip


def morton(cells: NDArray[np.integer]) -> NDArray[np.uint64]:
    """Compute the places of cells [N, 3], each number from 0 to 2^21 - 1, along a curve that fills space (Morton 1966),
    [N].

    The bits of the three numbers take turns, so different cells have different places.
    """
    key = np.zeros(len(cells), np.uint64)
    for axis in range(3):
        bits = cells[:, axis].astype(np.uint64)
        for shift, mask in _SPREAD.items():
            bits = (bits | (bits << np.uint64(shift))) & np.uint64(mask)
        key |= bits << np.uint64(axis)
    return key


def cells_of(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return cells of points [N, 3] in a grid of 2^21 cells along the longest side of their bounding box, [N, 3]."""
    low = points.min(0)
    cell = max(float((points.max(0) - low).max()) / (2**BITS - 1), 1e-300)
    return np.asarray((points - low) / cell).astype(np.int64)


def along_curve(points: NDArray[np.floating]) -> NDArray[np.int64]:
    """Return the order [N] of points [N, 3] along that curve; equal places and those that are not finite by index."""
    finite = np.nan_to_num(points.astype(np.float64), posinf=0.0, neginf=0.0)
    return np.argsort(morton(cells_of(finite)), kind="stable") if len(points) else np.zeros(0, np.int64)


def arrange(key: NDArray[np.uint64], *minor: NDArray[np.generic]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the order [N] by key, then each of ``minor``, then index; and which of them, so ordered, differ from the
    last."""
    order = np.argsort(key)
    ordered = key[order]
    new = np.r_[True, ordered[1:] != ordered[:-1]][: len(key)]
    run = np.flatnonzero(~new | np.r_[~new[1:], False])  # entries that share their key with another: few
    within = order[run][np.lexsort([order[run], *(m[order[run]] for m in reversed(minor)), ordered[run]])]
    order[run] = within
    differ = np.zeros(len(run), bool)
    for m in minor:
        differ[1:] |= m[within][1:] != m[within][:-1]
    new[run] |= differ
    return order, new
