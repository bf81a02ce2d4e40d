# SPDX-License-Identifier: GPL-3.0-or-later
"""Choose the photos to click on: a fifth of them, spread around the building, best seen first."""

from __future__ import annotations

import math

import numpy as np

from .colmap import Model

_FEWEST = 3


def choose_roots(model: Model) -> list[int]:
    """Choose photos, by farthest-point sampling on position and viewing direction.

    The same rule as the engine's, so that its report and the add-on name the same photos: start at the photo that
    sees most points; distance is taken in positions (median camera 5 units away from the points) and directions.
    """
    centres = np.array([p.centre for p in model.photos])
    directions = np.array([p.rotation[2] for p in model.photos])
    middle = centres.mean(axis=0)
    if len(model.points.xyz):  # the median of the points, each counted once per photo that sees it
        middle = np.median(np.repeat(model.points.xyz, np.maximum(model.points.track_length, 1), axis=0), axis=0)
    reach = np.median(np.linalg.norm(centres - middle, axis=1))
    feature = np.concatenate([(centres - middle) / max(reach, 1e-12), directions], axis=1)
    count = min(len(centres), max(_FEWEST, math.ceil(len(centres) / 5)))
    chosen = [int(np.argmax([p.observed for p in model.photos]))]
    distance = np.full(len(feature), np.inf)
    for _ in range(count - 1):
        distance = np.minimum(distance, np.linalg.norm(feature - feature[chosen[-1]], axis=1))
        distance[chosen] = -1.0
        chosen.append(int(np.argmax(distance)))
    return sorted(chosen)
