# SPDX-License-Identifier: GPL-3.0-or-later
"""Find floaters: wrong sparse points in empty space, from mirror images in panes or repeated structures.

A photo that shows sky at the projection of a point proves that its position is empty, whatever other photos observed.
Points on the building's outline project near the edge of the sky, so only those well inside the sky count.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.propagation.superpixels import Superpixels
from mgf_engine.model.scene import View
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class FloaterOptions:
    """Options of floaters, points that float in the air."""

    depth: float = parameter(
        0.013, "Distance from the edge of the sky from which a point before it floats, share of the longer side", high=1
    )
    photos: int = parameter(2, "Minimum number of photos that must show sky behind a floater", low=1)


def sky_behind(
    points: NDArray[np.float64],
    photos: Iterable[tuple[View, Superpixels, NDArray[np.int64]]],
    options: FloaterOptions = FloaterOptions(),
) -> NDArray[np.int64]:
    """Return each pair of a point and a piece of sky that a photo shows at its place, [K, 2].

    Args:
        points: normalised frame, [P, 3].
        photos: camera, superpixels, and the piece of sky of each of these (0 for none, [S]).
        options: how deep in the sky a point must lie.
    """
    pairs = [np.zeros((0, 2), np.int64)]
    for view, regions, sky in photos:
        pieces = sky[regions.labels]
        if not pieces.any():
            continue
        # At the frame sky goes on.
        bordered = cv2.copyMakeBorder((pieces > 0).astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_REPLICATE)
        depth = cv2.distanceTransform(bordered, cv2.DIST_L2, 3)[1:-1, 1:-1]
        deep = np.where(depth > options.depth * max(pieces.shape), pieces, 0)
        uv, _, framed = view.project_into_frame(points)
        rows, limit = np.flatnonzero(framed), np.array(pieces.shape[::-1]) - 1
        x, y = np.minimum(np.floor(uv[rows] * regions.scale).astype(np.int64), limit).T
        found = deep[y, x] > 0
        pairs.append(np.column_stack([rows[found], deep[y, x][found]]))
    return np.concatenate(pairs)
