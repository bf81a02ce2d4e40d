# SPDX-License-Identifier: GPL-3.0-or-later
"""Locate openings that the mesh has in the photos: their sides, and their level or arched heads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgf_engine.openings.arches import Proposals, find_heads, heads_of_contours
from mgf_engine.openings.detection import OpeningDetectionOptions
from mgf_engine.openings.photo_edges import EdgePhotos, move_edges
from mgf_engine.openings.wall_frame import WallFrame

Array = NDArray[np.float64]


class LocatedOpenings(NamedTuple):
    """Openings in walls.

    Attributes:
        boxes: left, top, right, bottom in coordinates of their walls, y up; the top is that of the crown, [n, 4].
        rises: of arched heads; 0 for level ones, [n].
        found: False for what is none, since the photos show no arch where the mesh has no level head, bool [n].
    """

    boxes: Array
    rises: Array
    found: NDArray[np.bool_]


def locate_openings(
    proposed: Proposals,
    frames: Mapping[int, WallFrame],
    pixel: float,
    photos: EdgePhotos | None,
    options: OpeningDetectionOptions = OpeningDetectionOptions(),
) -> LocatedOpenings:
    """Move the edges of openings to where the photos have them, and decide which have arched heads.

    Args:
        proposed: the openings as the mesh has them.
        frames: number of a wall -> its coordinates.
        pixel: a ground pixel in these coordinates.
        photos: to look at; None leaves edges where the mesh has them.
        options: of edges and arches.
    """
    heads, boxes = heads_of_contours(proposed), proposed.boxes
    if photos is not None:
        boxes = move_edges(boxes, proposed.walls, frames, pixel, photos, options.edges, heads.rises)
        heads = find_heads(proposed, boxes, frames, pixel, photos, options.arches, options.edges)
    return LocatedOpenings(np.column_stack([boxes[:, 0], heads.tops, boxes[:, 2:]]), heads.rises, heads.found)
