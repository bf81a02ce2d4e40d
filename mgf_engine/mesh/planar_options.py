# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of planar regions: where planes begin, what lies in them, what is too bent for one."""

from __future__ import annotations

from dataclasses import dataclass

from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class PlanarOptions:
    """Options of planar regions; a ground pixel is that of :func:`mgf_engine.mesh.ground_pixels.ground_pixels`."""

    least_area: float = parameter(400.0, "Minimum area of a plane", "ground px²")
    least_width: float = parameter(6.0, "Minimum width of a plane", "ground px")
    seed_side: float = parameter(10.0, "Side of the cells in which planes begin", "ground px", low=0.1)
    seed_area: float = parameter(25.0, "Minimum area of the faces of a seed cell", "ground px²")
    seed_even: float = parameter(0.95, "Minimum length of the mean normal of a seed cell", high=1)
    seed_coarse: int = parameter(
        4, "Number of seed cells along a coarse cell; the best of each coarse cell is tried first", low=1
    )
    tries: int = parameter(400, "Maximum number of cells in which a plane is begun")
    radii: tuple[float, float, float] = parameter(
        (15.0, 40.0, 120.0), "Radii around the beginning in which a plane is fitted, one after the other", "ground px"
    )
    same_angle: float = parameter(0.5, "Maximum angle between two planes that are one", "degrees")
    same_shift: float = parameter(0.15, "Maximum distance between two planes that are one", "ground px")
    merged_angle: float = parameter(1.5, "Maximum angle between two planes that are merged", "degrees")
    merged_distance: float = parameter(
        1.25, "Maximum distance of 90 % of a plane's faces from a larger plane that it is merged with; 0 merges"
        " coincident planes only", "ground px",
    )  # fmt: skip
    band: float = parameter(1.0, "Distance from a plane up to which faces belong to it and vertices move into it",
                            "ground px", low=1e-3)  # fmt: skip
    turn: float = parameter(30.0, "Maximum angle between a plane and the smoothed normals of its faces", "degrees")
    sigmas: float = parameter(3.0, "Distance that counts as noise, in standard deviations")
    bend_cell: float = parameter(
        12.0, "Side of the cells whose mean distances from the plane test for curvature", "ground px", low=0.1
    )
    bend_area: float = parameter(30.0, "Minimum area of the faces of such a cell of the curvature test", "ground px²")
    waves: float = parameter(0.6, "Maximum root mean square of the cells' mean distances from a plane", "ground px")
    bows: tuple[float, float] = parameter(
        (0.06, 0.3), "Bounds of the noise that a paraboloid through the faces must not exceed", "ground px"
    )
    known_bow: float = parameter(
        0.15, "Root mean square of that paraboloid up to which a plane through edges in the photos is none the less"
        " flat", "ground px",
    )  # fmt: skip
    known_noise: float = parameter(
        0.4, "Maximum noise of such a plane: two planes of one wall make a noisy third", "ground px"
    )
    known_gain: float = parameter(
        1.25, "Minimum area of such a plane, as a factor of its area on any one plane that begins on the surface"
    )
    bow_share: float = parameter(
        0.0008, "Root mean square of that paraboloid, as a share of the plane's width, up to which it is an error of"
        " stereo",
    )  # fmt: skip
    crease: float = parameter(20.0, "Minimum angle between two planes that meet in an edge", "degrees")
    crease_move: float = parameter(1.5, "Maximum distance that a vertex moves onto an edge or a corner", "ground px")
    rings: int = parameter(3, "Number of edges between a plane's vertices and those that may lie on its crease")
    normal_rounds: int = parameter(2, "Number of rounds that smooth the normals")
