# SPDX-License-Identifier: GPL-3.0-or-later
"""Frayed borders that are one straight line: eaves, soffits and corners, where the mesh goes round gently.

There the border between two regions wanders by pixels, and spurs of one region reach into the other. People see one
straight edge in the photos. It is level, upright, or a line that the planes of the mesh know.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.options.algorithms import parameter

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FrayOptions:
    """Options of frayed borders that are drawn as one line."""

    near: float = parameter(4.0, "Distance from the line within which most of the border lies", "ground px")
    share: float = parameter(0.7, "Share of the border that has to lie so near", high=1)
    apart: float = parameter(16.0, "Longest part of the border that may lie further away in one piece", "ground px")
    least: float = parameter(40.0, "Minimum length of the line", "ground px")
    turns: int = parameter(3, "Minimum number of corners on it, below which nothing is frayed", low=1)


@dataclass(frozen=True)
class FrayedPart:
    """A part of a border, corners ``first`` to ``last``, that is a line: ``a x + b y + c = 0`` with (a, b) of length 1;
    ``known`` is one that planes give."""

    first: int
    last: int
    line: Array
    known: bool

    def nearest(self, points: Array) -> Array:
        """Return the points of the line nearest to points [n, 2], [n, 2]."""
        off = points @ self.line[:2] + self.line[2]
        return np.asarray(points - off[:, None] * self.line[:2])


def frayed_parts(
    corners: Array, breaks: list[int], pixel: float, known: Array | None = None, options: FrayOptions = FrayOptions()
) -> list[FrayedPart]:
    """Find the parts of a border that are frayed lines; none overlaps another, known and longer ones come first.

    Args:
        corners: of pixels, [n, 2], drawing coordinates.
        breaks: rows where it turns.
        pixel: a ground pixel.
        known: lines that planes give, as :func:`mgf_engine.drawings.plane_lines.plane_lines` has them, [K, 5].
        options: how frayed it may be.
    """
    found = list[tuple[bool, float, FrayedPart]]()
    lines = [(line, True) for line in ([] if known is None else known)]
    lines += [(np.array([a, 1.0 - a, np.nan, -np.inf, np.inf]), False) for a in (0.0, 1.0)]
    for line, is_known in lines:
        across, along = corners @ line[:2], corners @ np.array([line[1], -line[0]])
        turn = np.arange(len(breaks))
        if is_known:
            beyond = np.maximum(line[3] - along, along - line[4])[breaks] > options.apart * pixel
            turn = turn[~beyond & (np.abs(across[breaks] + line[2]) <= options.near * pixel)]
        rows = np.array(breaks)[turn]
        for a, first in enumerate(rows):
            possible = turn[a + 1 :] - turn[a] > options.turns
            possible &= np.abs(along[rows[a + 1 :]] - along[first]) >= options.least * pixel
            possible &= np.abs(across[rows[a + 1 :]] - across[first]) <= 2 * options.near * pixel
            for last in rows[a + 1 :][possible]:
                offset = _offset(along[first : last + 1], across[first : last + 1], -line[2], pixel, options)
                if offset is not None:
                    length = abs(float(along[last] - along[first]))
                    part = FrayedPart(int(first), int(last), np.array([*line[:2], -offset]), is_known)
                    found.append((is_known, length, part))
    kept = list[FrayedPart]()
    for _, _, part in sorted(found, key=lambda entry: (-entry[0], -entry[1])):
        if all(part.last <= other.first or part.first >= other.last for other in kept):
            kept.append(part)
    return kept


def _offset(along: Array, across: Array, known: float, pixel: float, options: FrayOptions) -> float | None:
    """Return where across a part of a border is a frayed line, None where it is none.

    Args:
        along, across: coordinates of its corners, [n].
        known: place of the line, NaN takes the border's median.
        pixel: a ground pixel.
        options: how frayed it may be.
    """
    steps, middle = np.abs(np.diff(along)), 0.5 * (across[1:] + across[:-1])
    moved = steps > 1e-9 * pixel
    steps, middle = steps[moved], middle[moved]
    if steps.sum() > 1.5 * abs(float(along[-1] - along[0])):
        return None
    order = np.argsort(middle)
    median = float(middle[order][np.searchsorted(np.cumsum(steps[order]), 0.5 * steps.sum())])
    value = median if np.isnan(known) else known
    far = np.abs(middle - value) > options.near * pixel
    if steps[far].sum() > (1 - options.share) * steps.sum() or _longest(far, steps) > options.apart * pixel:
        return None
    return value if np.abs(across[[0, -1]] - value).max() <= options.near * pixel else None


def _longest(far: NDArray[np.bool_], steps: Array) -> float:
    """Return the length of the longest run of steps that are far from the line."""
    longest = now = 0.0
    for away, step in zip(far.tolist(), steps.tolist(), strict=True):
        now = now + step if away else 0.0
        longest = max(longest, now)
    return longest
