# SPDX-License-Identifier: GPL-3.0-or-later
"""The numbers of the starting surface, each with its unit; px: a pixel of a working photo, or its size in space."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SegmentOptions:
    """Edges in photos and lines in space."""

    shortest: float = 10.0  # px, of a segment
    most: int = 600  # segments of a photo, the longest ones
    margin: int = 6  # px beside the mask within which they count
    neighbours: int = 14  # photos that each photo is compared with
    angles: tuple[float, float] = (4.0, 55.0)  # degrees between their directions to the building
    reach: float = 1.5  # px, distance of a segment from a line that it supports
    colour: float = 9.0  # Lab, difference of the colours beside an edge; lightness counts a third
    overlap: float = 0.3  # share of a line that a segment must cover
    least_views: int = 3  # photos that must show a line
    least_score: float = 0.8  # sum of the supports, each 0..1
    residual: float = 1.0  # px, of the segments that stay
    spread: float = 10.0  # degrees between the rays to a line


@dataclass(frozen=True)
class PlaneOptions:
    """Planes through lines."""

    near: float = 1.0  # px, distance of lines from their plane
    most: int = 62  # planes
    least: float = 40.0  # px of lines that a plane must carry
    grid: float = 12.0  # px between the points on a plane
    reach: float = 12.0  # px that a plane reaches beyond its lines
    layer: float = 4.0  # px between parallel planes of which only the stronger one fills bare stretches
    crease: float = 5.0  # px between points where planes meet


@dataclass(frozen=True)
class DenseOptions:
    """Points by stereo."""

    neighbours: int = 4  # photos that each photo is matched with
    longest_side: int = 750  # px
    texture: float = 0.6  # L of Lab per px, gradient in the direction in which it is least within 7 x 7 px
    confirmed_by: int = 1  # other photos that must say the same
    size: float = 3.0  # px, side of the voxels that points are averaged in
    weight: float = 0.3  # of a ray, beside 1 for a point on a line


@dataclass(frozen=True)
class CutOptions:
    """What speaks how loudly in the cut; a ray to a point on a line has weight 1."""

    volume: float = 1e-3  # inside, per cubic px of the visual hull
    area: float = 0.03  # of a face, per square px,
    flat: float = 0.2  # times this on the strongest plane,
    slope: float = 0.25  # and on others by their strength to the power of -slope
    soft: float = 1.0  # px, uncertainty of points along their rays
    depth: float = 2.0  # px behind a point that are inside,
    behind: float = 0.3  # with this share of the weight of the ray,
    well_inside: float = 4.0  # where the point is so many px inside of the mask
    cover: float = 0.2  # of the ray of a mask pixel that the surface leaves uncovered,
    short: float = 12.0  # less if more px of it lie in the hull
    outside_views: int = 2  # so many masks must call a place outside,
    margin: float = 1.5  # by so many px


@dataclass(frozen=True)
class StartOptions:
    """All of the starting surface."""

    longest_side: int = 750  # px of the photos
    segments: SegmentOptions = SegmentOptions()
    planes: PlaneOptions = PlaneOptions()
    dense: DenseOptions = DenseOptions()
    cut: CutOptions = CutOptions()
