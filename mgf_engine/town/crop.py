# SPDX-License-Identifier: GPL-3.0-or-later
"""Crop box of a building in a town."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

from mgf_engine.options.algorithms import parameter
from mgf_engine.town.hulls import Hull
from mgf_engine.town.place import PlacedFootprints


@dataclass(frozen=True)
class BuildingBoxOptions:
    """Distances of the crop box from the footprint."""

    eaves: float = parameter(1.8, "Distance of the box from the footprint at free sides", "m")
    neighbour: float = parameter(0.3, "Distance of the box from the footprint towards a neighbour", "m")
    below: float = parameter(0.3, "Depth of the box below the ground", "m")
    unknown_height: float = parameter(
        40.0, "Height of the box over the ground where no points tell that of the building", "m", low=1.0
    )


def crop_box(
    hull: Hull, polygons: dict[str, Any], placed: PlacedFootprints, options: BuildingBoxOptions = BuildingBoxOptions()
) -> str:
    """Make the crop box of a building, as the option ``crop_box`` takes it (scene frame).

    It is the smallest rectangle around the footprint, wider by the eaves at free sides and only by the footprint's
    own error where a neighbour begins.

    Args:
        hull: of the building, local frame.
        polygons: footprints of all buildings by name, local frame.
        placed: georeference and length of a metre.
        options: distances to the footprint.
    """
    metre = placed.metre
    box = shapely.oriented_envelope(hull.polygon)
    corners = shapely.get_coordinates(box)[:4]
    along, across = corners[1] - corners[0], corners[3] - corners[0]
    sizes = np.linalg.norm(along), np.linalg.norm(across)
    axes = along / sizes[0], across / sizes[1]
    others = [p for name, p in polygons.items() if name != hull.id and p.distance(box) < 3 * metre]
    reach = []
    for axis, other, size, start in ((axes[0], axes[1], sizes[1], 0), (axes[1], axes[0], sizes[0], 1)):
        origin = corners[0]
        length = sizes[start]
        for sign, base in ((-1.0, origin), (1.0, origin + axis * length)):
            strip = shapely.Polygon([base, base + other * size, base + other * size + sign * axis * 1.2 * metre,
                                     base + sign * axis * 1.2 * metre])  # fmt: skip
            taken = sum(strip.intersection(p).area for p in others) > 0.1 * strip.area
            reach.append((options.neighbour if taken else options.eaves) * metre)
    low = np.array([-reach[0], -reach[2]])
    high = np.array([sizes[0] + reach[1], sizes[1] + reach[3]])
    middle, half = (low + high) / 2, (high - low) / 2
    bottom, top = hull.low - options.below * metre, hull.low + options.unknown_height * metre
    if hull.height_known:
        top = hull.high + max(4 * metre, 0.75 * (hull.high - hull.low))
    matrix = np.eye(4)
    matrix[:2, 0], matrix[:2, 1] = axes[0] * half[0], axes[1] * half[1]
    matrix[2, 2] = (top - bottom) / 2
    matrix[:2, 3] = corners[0] + axes[0] * middle[0] + axes[1] * middle[1]
    matrix[2, 3] = (top + bottom) / 2
    return " ".join(f"{v:.12g}" for v in (np.linalg.inv(placed.georeference.to_local) @ matrix).ravel())
