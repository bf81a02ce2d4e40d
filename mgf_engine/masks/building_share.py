# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimate the share of the photos that the building fills from the clicks alone, before there are masks."""

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
    """Estimate the share of the pixels of the clicked photos that shows the building; None with too few clicks.

    It is the geometric mean of two estimates, since each fails for some distributions of clicks. One is the area nearer
    to a click on the building than to one beside it, within the clicks' spread around their mean. The other is the area
    of the ellipse of their standard deviations, times :data:`_REACH`.

    Args:
        clicks: the prompts file.
        size: typical long and short side of the photos in pixels.
    """
    try:
        photos = list(json.loads(clicks.content).values())
        pairs = [(_points(p.get("positive", [])), _points(p.get("negative", []))) for p in photos]
    except (ValueError, TypeError, AttributeError, RecursionError):
        return None  # the masks stage reports what is wrong with the file
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
