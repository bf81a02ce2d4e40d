# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of the evidence for a solid."""

from __future__ import annotations

from dataclasses import dataclass

from mgf_engine.drawings.ground import GroundLevelOptions
from mgf_engine.drawings.regions import RegionOptions
from mgf_engine.mesh.planar_options import PlanarOptions
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class EvidenceOptions:
    """Options of the evidence for a solid."""

    detail_pixels: float = parameter(8.0, "Detail, where none is given", "ground px", low=0.1)
    detail_share: float = parameter(0.01, "Minimum of that detail, as a share of the building's size", high=1)
    largest_tilt: float = parameter(75.0, "Largest tilt of a roof plane", "degrees", high=89)
    level: float = parameter(1.5, "Tilt below which a roof plane is made level", "degrees", high=45)
    least_roof: float = parameter(0.005, "Minimum area of a roof plane, as a share of the footprint", high=1)
    round_least: float = parameter(
        16.0, "Minimum area of a part in no roof plane that gets planes of its own, in squared details"
    )
    round_opening: float = parameter(
        0.5, "Radius of the opening that narrow parts in no roof plane fall out by, in details"
    )
    round_level: float = parameter(15.0, "Median tilt below which such a part is level", "degrees", high=90)
    round_side: float = parameter(0.1, "Minimum share of such a part that falls towards a side", high=1)
    main_angle: float = parameter(
        4.0, "Largest angle between a wall and the main direction that it is turned into", "degrees", low=0.1, high=45
    )
    most_lines: int = parameter(60, "Maximum number of lines that cut the ground plan", low=4)
    same_angle: float = parameter(8.0, "Largest angle between two lines that are merged", "degrees", high=90)
    overhang: float = parameter(4.0, "Largest distance between a wall and its eaves, in details")
    overhang_share: float = parameter(
        0.1, "Minimum distance between a wall and its eaves, as a share of the building's height"
    )
    winding: float = parameter(0.35, "Winding number of the mesh from which a place is inside", high=1)
    inside_height: float = parameter(0.45, "Height at which places are tested, as a share of the building's", high=1)
    least_wall: float = parameter(0.004, "Minimum area of a wall, as a share of all walls", high=1)
    same_direction: float = parameter(15.0, "Largest angle between the walls of one direction", "degrees", high=90)
    most_directions: int = parameter(12, "Maximum number of directions of walls", low=1)
    regions: RegionOptions = RegionOptions()
    planes: PlanarOptions = PlanarOptions()
    ground: GroundLevelOptions = GroundLevelOptions()
