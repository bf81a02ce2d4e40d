# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of the second level: elements of one photo, parts of the scene."""

from __future__ import annotations

from dataclasses import dataclass

from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class PartOptions:
    """Options of the elements of the building."""

    smallest: float = parameter(0.001, "Minimum area of an element, as a share of the building", high=1)
    largest: float = parameter(0.5, "Maximum area of an element, as a share of the building", high=1)
    grid: int = parameter(12, "Number of EfficientSAM prompts along the longer side of the building", low=1)
    quality: float = parameter(0.8, "Minimum predicted quality of a mask of EfficientSAM", high=1)
    stability: float = parameter(0.9, "Minimum stability of a mask of EfficientSAM", high=1)
    overlap: float = parameter(0.6, "Maximum overlap (intersection over union) of two masks of EfficientSAM", high=1)
    sigma: float = parameter(
        0.6, "Standard deviation of the blur before the segmentation by colour (Felzenszwalb and Huttenlocher)", "px"
    )
    scale: float = parameter(250.0, "Scale k of that segmentation; a larger one prefers larger segments", low=1)
    contrast: float = parameter(4.0, "Minimum colour distance (CIELAB) between an element and what is around it")
    margin: int = parameter(8, "Width around the building in which segments may end", "px", low=1)
    shared: int = parameter(3, "Minimum number of points that two elements of one part share", low=1)
    common: float = parameter(
        0.5, "Minimum share of the points seen in both photos that two elements of one part share", high=1
    )
