# SPDX-License-Identifier: GPL-3.0-or-later
"""How much of the photos the building fills, guessed from the clicks alone: for estimates, before there are masks."""

from __future__ import annotations

import json
import math

import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.prompts import PromptsFile

_GRID = (24, 16)
_FEWEST = 3  # clicks on the building that tell its extent in a photo
#: Area of a building over that of the ellipse of its clicks: 3.8 were they spread evenly over a rectangle; people keep
#: away from its borders.
_REACH = 6.0


def building_share(clicks: PromptsFile, size: tuple[int, int]) -> float | None:
    """Return the share of the pixels of the clicked photos that shows the building; None where the clicks do not tell.

    The geometric mean of two guesses, for each is far off where the clicks lie badly. One is the area around the clicks
    on the building: places nearer to them than to one beside it, and no further away than they spread around their
    middle. The other is the area of the ellipse of their standard deviations, :data:`_REACH` times as large.

    Args:
        size: usual long and short side of the photos in pixels.
    """
    try:
        photos = list(json.loads(clicks.content).values())
        pairs = [(_points(p.get("positive", [])), _points(p.get("negative", []))) for p in photos]
    except (ValueError, TypeError, AttributeError, RecursionError):
        return None  # what is wrong with the file is said when the masks are made
    pairs = [(on, off) for on, off in pairs if len(on) >= _FEWEST]
    if not pairs:
        return None
    around = float(np.mean([_area_around(on, off, size) for on, off in pairs]))
    ellipses = float(np.mean([_area_of_ellipse(on, size) for on, _ in pairs]))
    return math.sqrt(around * ellipses) or None


def _points(clicks: object) -> NDArray[np.float64]:
    return np.array(clicks, np.float64).reshape(-1, 2)


def _area_around(on: NDArray[np.float64], off: NDArray[np.float64], size: tuple[int, int]) -> float:
    every = np.concatenate([on, off])
    width, height = size[::-1] if every[:, 1].max() > size[1] else size  # a photo taken upright
    x, y = ((np.arange(n) + 0.5) / n * side for n, side in zip(_GRID, (width, height), strict=True))
    places = np.stack(np.meshgrid(x, y), -1).reshape(-1, 1, 2)

    def distance(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.linalg.norm(places - points, axis=2).min(1, initial=np.inf))

    reach, near = float(np.sqrt(on.var(0).sum())), distance(on)
    return float(((near < distance(off)) & (near < reach)).mean())


def _area_of_ellipse(on: NDArray[np.float64], size: tuple[int, int]) -> float:
    deviations = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(on.T)), 0.0))
    return min(1.0, _REACH * math.pi * float(deviations.prod()) / (size[0] * size[1]))
