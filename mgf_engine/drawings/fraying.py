# SPDX-License-Identifier: GPL-3.0-or-later
"""Frayed borders that are one level or upright line: eaves, soffits and corners, where the mesh goes round gently.

There the border between two regions wanders by pixels, and spurs of one region reach into the other. People see one
straight edge in the photos.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.algorithms import parameter

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FrayOptions:
    """Options of frayed borders that are drawn as one level or upright line."""

    near: float = parameter(4.0, "Distance from the line within which most of the border lies", "ground px")
    share: float = parameter(0.7, "Share of the border that has to lie so near", high=1)
    apart: float = parameter(16.0, "Longest part of the border that may lie further away in one piece", "ground px")
    least: float = parameter(40.0, "Minimum length of the line", "ground px")
    turns: int = parameter(3, "Minimum number of corners on it, below which nothing is frayed", low=1)


@dataclass(frozen=True)
class LevelPart:
    """A part of a border, corners ``first`` to ``last``, that is a line: ``axis`` 0 is level, 1 is upright; at
    ``value`` of the other axis."""

    first: int
    last: int
    axis: int
    value: float


def level_parts(
    corners: Array, breaks: list[int], pixel: float, options: FrayOptions = FrayOptions()
) -> list[LevelPart]:
    """Find the parts of a border that are frayed level or upright lines, longest first; none overlaps another.

    Args:
        corners: of pixels, [n, 2], drawing coordinates.
        breaks: rows where it turns.
        pixel: a ground pixel.
        options: how frayed it may be.
    """
    found = list[tuple[float, LevelPart]]()
    for a, first in enumerate(breaks):
        for last in breaks[a + options.turns + 1 :]:
            for axis in range(2):
                length = abs(float(corners[last, axis] - corners[first, axis]))
                part = _part(corners, first, last, axis, pixel, options) if length >= options.least * pixel else None
                if part is not None:
                    found.append((length, part))
    kept = list[LevelPart]()
    for _, part in sorted(found, key=lambda entry: -entry[0]):
        if all(part.last <= other.first or part.first >= other.last for other in kept):
            kept.append(part)
    return kept


def _part(corners: Array, first: int, last: int, axis: int, pixel: float, options: FrayOptions) -> LevelPart | None:
    """Return the part from one corner to another, if that is a frayed line along an axis."""
    steps = np.abs(np.diff(corners[first : last + 1, axis]))
    across = 0.5 * (corners[first:last, 1 - axis] + corners[first + 1 : last + 1, 1 - axis])
    along = steps > 0
    steps, across = steps[along], across[along]
    length = abs(float(corners[last, axis] - corners[first, axis]))
    if steps.sum() > 1.5 * length:
        return None
    order = np.argsort(across)
    value = float(across[order][np.searchsorted(np.cumsum(steps[order]), 0.5 * steps.sum())])
    far = np.abs(across - value) > options.near * pixel
    if steps[far].sum() > (1 - options.share) * steps.sum() or _longest(far, steps) > options.apart * pixel:
        return None
    ends = np.abs(corners[[first, last], 1 - axis] - value)
    return LevelPart(first, last, axis, value) if ends.max() <= options.near * pixel else None


def _longest(far: NDArray[np.bool_], steps: Array) -> float:
    """Return the length of the longest run of steps that are far from the line."""
    longest = now = 0.0
    for away, step in zip(far.tolist(), steps.tolist(), strict=True):
        now = now + step if away else 0.0
        longest = max(longest, now)
    return longest
