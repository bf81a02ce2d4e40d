# SPDX-License-Identifier: GPL-3.0-or-later
"""The foot of a building in its elevations: where terrain tells the ground, lines end there.

Photos show the foot of a wall badly: grass, shrubs and shadows blur the mesh there, and parts of it hang below the
ground. A draughtsman ends the wall at the line of the ground.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from mgf_engine.drawings.ground import TERRAIN, GroundLevel
from mgf_engine.drawings.model import Array
from mgf_engine.drawings.regions import NOTHING, RegionMap
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class FootOptions:
    """Options of the foot of buildings in elevations."""

    uneven: float = parameter(
        3.0, "Maximum distance between the quartiles of the heights of the terrain; elevations end at the ground where "
        "it is no more", "ground px",
    )  # fmt: skip
    deepest: float = parameter(
        24.0, "Depth below the ground from which a part is no noise but dug in, and stays", "ground px"
    )


def cut_at_ground(
    regions: RegionMap, ground: GroundLevel, pixel: float, options: FootOptions = FootOptions()
) -> Array | None:
    """Remove what a map shows below the ground, and return the ground as a line that borders may lie on.

    Args:
        regions: of an elevation; labels are changed in place.
        ground: around the building.
        pixel: a ground pixel, local unit.
        options: how level it has to be.

    Returns:
        The line as :func:`mgf_engine.drawings.plane_lines.plane_lines` has them, [1, 5]; None where the ground is not
        level or not known.
    """
    if ground.source != TERRAIN or ground.spread > options.uneven * pixel:
        return None
    grid, label = regions.grid, regions.label
    height = ground.height - float(grid.frame.origin[2])
    first = int(np.clip(np.rint(grid.pixels(np.array([0.0, height]))[1]), 0, grid.height))
    below = label[first:]
    _, part, stats, _ = cv2.connectedComponentsWithStats((below != NOTHING).astype(np.uint8), connectivity=4)
    dug = stats[:, cv2.CC_STAT_HEIGHT] * grid.resolution > options.deepest * pixel
    below[~dug[part]] = NOTHING
    return np.array([[0.0, 1.0, -height, -np.inf, np.inf]])
