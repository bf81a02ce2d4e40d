# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of depth maps and their fusion into a signed distance."""

from __future__ import annotations

from dataclasses import dataclass

from mgf_engine.mesh.depth_smoothing import SmoothingOptions
from mgf_engine.mesh.hull import HullOptions
from mgf_engine.mesh.photometric import MatchOptions
from mgf_engine.mesh.prior import PriorOptions
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class TsdfOptions:
    """Options of the fusion of depth maps."""

    band: float = parameter(
        2.0, "Half width of the truncation band of the signed distance, at the depth of the surface", "px"
    )
    jump: float = parameter(0.01, "Difference of neighbouring depths of one surface, as a share of the depth", low=1e-6)
    mixed: float = parameter(
        0.01, "Difference of mean and median depth beyond which a pixel shows several surfaces, as a share of the depth"
    )
    min_alpha: float = parameter(0.5, "Minimum opacity of a pixel that shows a surface", high=1)
    free_space_alpha: float = parameter(0.2, "Opacity below which a pixel shows free space", high=1)
    free_space_weight: float = parameter(
        0.25, "Weight of a pixel that shows free space, as a share of the median weight of depths"
    )
    unmatched: float = parameter(0.2, "Weight of a depth without a match; a matched depth weighs 1")
    least_slope: float = parameter(
        0.1, "Minimum distance along the normal per unit of depth, for surfaces seen from the side", low=1e-6
    )
    confirmed: float = parameter(
        0.5, "Distance from the views' surface beyond which the mesh is unconfirmed, as a share of the band", high=1
    )
    full_views: int = parameter(3, "Number of photos that must show a point for full confidence", low=1)
    outvoted: int = parameter(
        3,
        "Views with a surface in front of a point that outvote those that see it free, per square of their number",
    )
    calibration_points: int = parameter(50, "Minimum number of sparse points that calibrate the level", low=1)

    hull: HullOptions = HullOptions()


@dataclass(frozen=True)
class FusionOptions:
    """All options of depth maps and their fusion."""

    tsdf: TsdfOptions = TsdfOptions()
    match: MatchOptions = MatchOptions()
    prior: PriorOptions = PriorOptions()
    smoothing: SmoothingOptions = SmoothingOptions()
