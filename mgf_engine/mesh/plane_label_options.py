# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of the labels of planes: what a plane costs, how far it reaches, which groups go into the plane around."""

from __future__ import annotations

from dataclasses import dataclass

from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class PlaneLabelOptions:
    """Options of the labels; costs are per square ground pixel."""

    reach: float = parameter(6.0, "Maximum distance of a vertex from its plane", "ground px")
    rings: int = parameter(20, "Maximum number of edges between a vertex and the faces that the plane was found on")
    trusted_distance: float = parameter(1.0, "Distance from the plane up to which photos are not compared", "ground px")
    largest_area: float = parameter(
        9.0, "Maximum area of a vertex that counts, so that none decides alone", "ground px²"
    )
    no_plane_cost: float = parameter(0.1, "Cost of a vertex without plane")
    distance_cost: float = parameter(0.1, "Cost of the maximum distance from the plane")
    small_plane_cost: float = parameter(0.1, "Cost of a plane that is small or noisy")
    small_area: float = parameter(4000.0, "Area below which a plane is small", "ground px²")
    large_noise: float = parameter(0.5, "Standard deviation from which a plane is noisy", "ground px", low=1e-3)
    sure_area: float = parameter(20000.0, "Area from which on a plane counts as less noisy, in inverse proportion",
                                 "ground px²")  # fmt: skip
    contrast: float = parameter(8.0, "Standard deviation of a patch that makes the photos sure", "grey levels", low=0.1)
    plain_contrast: float = parameter(
        2.0, "Standard deviation of a patch up to which it may be noise and show no texture", "grey levels"
    )
    plain_correlation: float = parameter(0.2, "Correlation between photos below which such a patch is noise", high=1)
    margin: float = parameter(
        0.3, "Correlation by which the plane must be better where the photos are sure, beyond creases", high=1
    )
    sure_parallax: float = parameter(
        1.5, "Parallax between vertex and plane from which on the margin is asked for in full", "px", low=1e-3
    )
    crease: float = parameter(30.0, "Minimum angle between two planes that meet in a crease", "degrees")
    crease_reach: float = parameter(
        3.0, "Distance from both planes up to which a vertex is at their crease", "ground px"
    )
    beyond_cost: float = parameter(1.0, "Cost of each ground pixel beyond the crease with another plane")
    beyond_noise: float = parameter(0.5, "Distance beyond a crease that costs nothing", "ground px")
    side_reach: float = parameter(30.0, "Distance from a plane up to which it is asked on which side another lies",
                                  "ground px")  # fmt: skip
    side: float = parameter(0.9, "Minimum share of such vertices on one side", high=1)
    step_cost: float = parameter(0.2, "Cost of an edge whose ends have different labels, a step apart")
    full_step: float = parameter(2.0, "Distance between the places of two labels that costs a full step", "ground px")
    facing: float = parameter(-0.2, "Minimum cosine between a vertex's normal and the plane's", low=-1.0, high=1)
    island_area: float = parameter(100.0, "Area up to which vertices without plane go into the plane around them",
                                   "ground px²")  # fmt: skip
    island_height: float = parameter(2.5, "Maximum distance of such vertices from that plane", "ground px")
    bump_texture: float = parameter(
        0.3, "Maximum share of a bump's area on which photos show texture, for it to go into the plane around it from"
        " any area and up to `reach` before it", high=1,
    )  # fmt: skip
    rounds: int = parameter(10, "Number of rounds of iterated conditional modes")
