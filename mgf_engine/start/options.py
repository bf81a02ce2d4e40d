# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of the starting surface; px: a pixel of a working photo, or its size at the building."""

from __future__ import annotations

from dataclasses import dataclass

from mgf_engine.masks.geometry.visual_hull import MaskHullOptions
from mgf_engine.options.algorithms import parameter
from mgf_engine.options.config import Config, job_option
from mgf_engine.scene.coarse_stereo import CoarseStereoOptions
from mgf_engine.scene.patch_match import PatchMatchOptions
from mgf_engine.scene.stereo import StereoOptions


@dataclass(frozen=True)
class ViewOptions:
    """Photos and masks that the surface is made from."""

    longest_side: int = parameter(750, "Longest side of the photos", "px", low=16)
    padding: float = parameter(0.3, "Space around the points, as a share of their box's longest side")
    least_track: int = parameter(3, "Minimum number of photos that observed a sparse point", low=1)
    track_share: float = parameter(
        0.66, "Minimum share of the photos that observed a sparse point whose masks contain it", high=1
    )
    percentiles: tuple[float, float] = parameter(
        (2.0, 98.0), "Percentiles of the sparse points between which the building lies", high=100
    )
    hull_views: int = parameter(
        4, "Number of masks that must call a cell outside, in the coarse hull that finds faulty masks"
    )
    hull_cells: int = parameter(
        60, "Number of cells of the coarse hull that finds faulty masks, along its longest side", low=1
    )
    distrust_factor: float = parameter(
        3.0, "Maximum share of the coarse hull that a mask may cut off, as a factor of the median of all masks"
    )
    distrust_share: float = parameter(0.02, "Share of the coarse hull that every mask may cut off", high=1)
    hull_margin: float = parameter(
        2.0, "Distance from a mask from which it calls a cell of the coarse hull outside", "px"
    )

    hull: MaskHullOptions = MaskHullOptions()


@dataclass(frozen=True)
class OutsideOptions:
    """When the masks call a point outside."""

    least_views: int = parameter(2, "Minimum number of masks that must call a point outside", low=1)
    share: float = parameter(
        0.05, "Minimum share of the photos that have the point in their frame whose masks call it outside", high=1
    )
    margin: float = parameter(1.5, "Distance from the mask from which a point is outside", "px")


@dataclass(frozen=True)
class SegmentOptions:
    """Edges in photos and lines in space."""

    shortest: float = parameter(10.0, "Minimum length of a segment", "px")
    most: int = parameter(600, "Maximum number of segments per photo; the longest are kept", low=1)
    margin: int = parameter(6, "Distance from the mask up to which segments count", "px")
    side: tuple[float, float] = parameter((2.0, 4.0), "Distances from an edge between which its colours are read", "px")
    along: tuple[float, float] = parameter(
        (0.15, 0.85), "Positions along an edge between which its colours are read, as shares of its length", high=1
    )
    neighbours: int = parameter(14, "Number of photos that each photo is compared with", low=1)
    angles: tuple[float, float] = parameter(
        (4.0, 55.0), "Angle between the viewing directions of two compared photos", "degrees", high=180
    )
    reach: float = parameter(1.5, "Maximum distance between a line and a segment that supports it", "px")
    color: float = parameter(9.0, "Maximum difference in Lab of the colours beside an edge; lightness counts a third")
    overlap: float = parameter(0.3, "Share of a line that a supporting segment must cover", high=1)
    least_views: int = parameter(3, "Minimum number of photos that show a line", low=2)
    least_score: float = parameter(
        0.8, "Minimum score of a line: the sum of the support (0 to 1) by a segment of each photo"
    )
    residual: float = parameter(1.0, "Maximum residual of a segment that supports the fitted line", "px")
    spread: float = parameter(10.0, "Minimum angle between two rays to a line", "degrees")
    outside_share: float = parameter(0.3, "Share of a line that may lie outside", high=1)
    aliased_blur: float = parameter(
        2.0, "Standard deviation by which photos are blurred whose texture aliases, before edges are found", "px"
    )
    step: float = parameter(4.0, "Distance between the points on a line", "px", low=0.5)
    shortest_line: float = parameter(2.0, "Minimum length of a line that gets points", "px")

    outside: OutsideOptions = OutsideOptions()


@dataclass(frozen=True)
class PlaneOptions:
    """Planes through lines."""

    near: float = parameter(1.0, "Maximum distance of a line from its plane", "px")
    near_sparse: float = parameter(
        2.0, "Maximum distance of a sparse point that moves onto a plane, as a factor of near"
    )
    near_dense: float = parameter(
        1.5, "Maximum distance of a stereo point that moves onto a plane, as a factor of near"
    )
    longest_move: float = parameter(
        2.0, "Maximum move of a point onto several planes, as a factor of the distance within which points move"
    )
    on_plane: float = parameter(
        0.1,
        "Distance within which a moved point lies on a plane, as a share of the distance within which points move",
        high=1,
    )
    common_cosine: float = parameter(
        0.97, "Cosine between the normals of two planes from which no point moves onto both planes", high=1
    )
    common_rank: float = parameter(
        0.05, "Singular value, as a share of the largest, up to which a point does not move along a direction", high=1
    )
    most: int = parameter(62, "Maximum number of planes, without those of separate", low=1)
    separate: float = parameter(
        0.4,
        "Minimum strength of a plane whose lines lie on others and that has no parallel plane within rectangle_layer, "
        "as a factor of the median strength",
    )
    least: float = parameter(40.0, "Minimum total length of the lines on a plane", "px")
    grid: float = parameter(12.0, "Distance between the points on a plane", "px", low=1)
    reach: float = parameter(12.0, "Distance that a plane extends beyond its lines", "px")
    rectangle_share: float = parameter(
        0.1,
        "Minimum share of line length along each side of a plane's bounding rectangle; else the convex hull is filled",
        high=1,
    )
    rectangle_layer: float = parameter(
        24.0, "Distance of parallel planes of which only the stronger one covers its rectangle", "px"
    )
    layer: float = parameter(4.0, "Distance of parallel planes of which only the stronger one fills bare areas", "px")
    crease: float = parameter(5.0, "Distance between points where planes meet", "px", low=1)
    direction_angle: float = parameter(3.0, "Maximum angle between a line and its dominant direction", "degrees")
    direction_share: float = parameter(0.04, "Minimum share of all line length along a dominant direction", high=1)
    directions: int = parameter(8, "Maximum number of dominant directions")
    direction_sine: float = parameter(
        0.5, "Minimum sine of the angle between the two dominant directions of a plane", high=1
    )
    parallel: float = parameter(4.0, "Maximum angle between two lines that count as parallel", "degrees")
    apart: float = parameter(5.0, "Minimum distance of two parallel lines that make a plane", "px")
    crossing: float = parameter(15.0, "Minimum angle between two lines that count as crossing", "degrees")
    along: float = parameter(2.0, "Maximum angle between a line and a plane of two dominant directions", "degrees")
    candidates: int = parameter(4000, "Maximum number of pairs of lines that are tried", low=1)
    regular_weight: float = parameter(2.0, "Weight of planes along two dominant directions")
    longest: float = parameter(100.0, "Maximum length that a single line adds to the strength of a plane", "px")
    carried: tuple[float, float] = parameter(
        (0.7, 0.1), "Weights of a line that lies on one stronger plane, and of a line that lies on several", high=1
    )
    cross_factor: float = parameter(
        6.0,
        "Maximum line length in the strength of a plane, as a factor of the length of lines across its longest line",
    )
    regular_share: float = parameter(
        0.5, "Minimum share of line length in the strength of planes along two dominant directions", high=1
    )
    strength_share: float = parameter(0.2, "Minimum share of line length in the strength of any plane", high=1)
    strongest: int = parameter(3, "Number of the strongest planes whose mean strength counts as 1", low=1)
    same_cosine: float = parameter(0.9995, "Minimum cosine between the normals of two planes that are merged", high=1)
    same_distance: float = parameter(0.5, "Maximum distance of two planes that are merged", "px")
    layer_cosine: float = parameter(
        0.995, "Minimum cosine between the normals of two planes that count as parallel layers", high=1
    )
    crease_sine: float = parameter(0.25, "Minimum sine of the angle between planes that meet in a crease", high=1)
    crease_reach: float = parameter(1.2, "Distance of a crease from the points of its planes, as a factor of grid")
    contradiction_radius: float = parameter(10.0, "Radius in which stereo points contradict a plane", "px")
    contradiction_points: int = parameter(4, "Minimum number of stereo points that contradict a plane", low=1)
    contradiction_distance: float = parameter(
        2.0, "Median distance of stereo points from a plane from which they contradict it", "px"
    )


@dataclass(frozen=True)
class AliasedPointOptions:
    """Points by stereo on reduced photos, where fine textures alias; they replace those of start_stereo."""

    texture: float = parameter(0.3, "Minimum gradient of L (Lab) per px of the reduced photo in the weakest direction")
    confirmed_by: int = parameter(2, "Number of further photos that must confirm a point")
    least_share: float = parameter(0.3, "Minimum share of the photos expected to see a point that confirm it", high=1)
    weight: float = parameter(0.9, "Weight of a ray to a stereo point; a ray to a point on a line weighs 1")


@dataclass(frozen=True)
class DenseOptions:
    """Points by stereo."""

    neighbours: int = parameter(4, "Number of photos that each photo is matched with", low=1)
    longest_side: int = parameter(750, "Longest side of the matched photos", "px", low=16)
    texture: float = parameter(0.6, "Minimum gradient of L (Lab) per px in the weakest direction within 7 x 7 px")
    confirmed_by: int = parameter(1, "Number of further photos that must confirm a point")
    largest_angle: float = parameter(50.0, "Maximum angle between two photos that confirm each other", "degrees")
    size: float = parameter(3.0, "Side of the voxels in which points are averaged", "px", low=0.1)
    least_points: int = parameter(2, "Minimum number of points in a voxel", low=1)
    seen_share: float = parameter(0.4, "Share of a voxel's points that a photo must have seen to count for it", high=1)
    normal_neighbours: int = parameter(
        40, "Number of nearest neighbours from which a point's normal is estimated", low=3
    )
    grazing_angle: float = parameter(
        70.0, "Angle to the normal from which a photo need not confirm a point", "degrees", high=90
    )
    least_share: float = parameter(0.5, "Minimum share of the photos expected to see a point that confirm it", high=1)
    full_share: float = parameter(
        0.9, "Share of confirming photos from which a point has full weight", low=0.01, high=1
    )
    weight: float = parameter(0.3, "Weight of a ray to a stereo point; a ray to a point on a line weighs 1")

    aliased: AliasedPointOptions = AliasedPointOptions()
    coarse: CoarseStereoOptions = CoarseStereoOptions()
    stereo: StereoOptions = StereoOptions()
    patch_match: PatchMatchOptions = PatchMatchOptions()
    hull: MaskHullOptions = MaskHullOptions()


@dataclass(frozen=True)
class PointSmoothingOptions:
    """Smoothing of points by stereo."""

    rounds: int = parameter(1, "Number of rounds that move points onto planes fitted to their neighbours; 0 for none")
    neighbours: int = parameter(20, "Number of nearest neighbours that each plane is fitted to", low=3)
    radius: float = parameter(4.0, "Standard deviation of the weight of neighbours by distance", "px", low=0.01)
    offset: float = parameter(
        2.0, "Standard deviation of the weight of neighbours by distance from the fitted plane", "px", low=0.01
    )
    most: float = parameter(6.0, "Maximum move of a point per round", "px")


@dataclass(frozen=True)
class MinimumCutOptions:
    """Weights of the minimum cut; a ray to a point on a line weighs 1."""

    volume: float = parameter(1e-3, "Reward of volume inside, per px³ of the visual hull")
    free_space: float = parameter(
        30.0, "Weight of the rays through a tetrahedron beyond which they reduce the reward of volume inside"
    )
    area: float = parameter(0.03, "Cost of a face, per px²")
    flat: float = parameter(0.2, "Factor on the cost of faces on the strongest plane")
    slope: float = parameter(
        0.25, "Exponent of a plane's strength: the cost of its faces has the factor flat / strength^slope"
    )
    soft: float = parameter(1.0, "Uncertainty of points along their rays", "px")
    depth: float = parameter(3.0, "Depth behind a point that counts as inside", "px")
    behind: float = parameter(
        1.0, "Weight of the tetrahedra behind a point that count as inside, as a share of the weight of the ray"
    )
    off_surface: float = parameter(
        6.0, "Distance of the points added behind stereo points to give thin parts a volume; 0 for none", "px"
    )
    well_inside: float = parameter(
        4.0, "Minimum distance from the outline of the mask of points behind which the building is inside", "px"
    )
    cover: float = parameter(0.2, "Weight of the ray through a mask pixel that the surface does not cover")
    short: float = parameter(
        12.0, "Length within the hull beyond which the ray through an uncovered mask pixel weighs less", "px", low=0.1
    )
    outside_share: float = parameter(
        0.5, "Share of a tetrahedron outside of the visual hull from which all of it is outside", high=1
    )
    least_points: int = parameter(20, "Minimum number of observed points for a surface", low=4)
    merge: float = parameter(0.5, "Side of the cubes in which points are merged", "px", low=0.01)
    padding: float = parameter(
        0.5,
        "Space between the points and the bounding box of the tetrahedra, as a share of their longest side",
        low=0.01,
    )
    margin: float = parameter(60.0, "Distance from a block within which no points are merged into coarse cubes", "px")
    coarse: float = parameter(
        12.0, "Side of the coarse cubes in which points farther from a block are merged", "px", low=0.01
    )

    blocks: int = job_option("blocks")

    outside: OutsideOptions = OutsideOptions()


@dataclass(frozen=True)
class StartOptions:
    """All options of the starting surface."""

    views: ViewOptions = ViewOptions()
    segments: SegmentOptions = SegmentOptions()
    planes: PlaneOptions = PlaneOptions()
    dense: DenseOptions = DenseOptions()
    smoothing: PointSmoothingOptions = PointSmoothingOptions()
    cut: MinimumCutOptions = MinimumCutOptions()


def start_options(config: Config) -> StartOptions:
    """Return the options of the starting surface as the user set them."""
    return StartOptions(
        config.algorithm(ViewOptions),
        config.algorithm(SegmentOptions),
        config.algorithm(PlaneOptions),
        config.algorithm(DenseOptions),
        config.algorithm(PointSmoothingOptions),
        config.algorithm(MinimumCutOptions),
    )
