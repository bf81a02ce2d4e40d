# SPDX-License-Identifier: GPL-3.0-or-later
"""Improve depth maps by PatchMatch stereo (Bleyer et al. 2011) against several neighbours at once.

Semi-global matching compares pairs of photos on surfaces that face the camera. Here each pixel holds a plane, tries
those of pixels around it, and keeps the one with the highest correlation in its neighbours; a second pass adds the
distance from the depths that the first one found in these (geometric consistency, Schönberger et al. 2016). A depth
counts if both matchings find it: depths that only one finds are mostly reflections, or ground at the masks' borders.
By default it is for scenes most of whose photos semi-global matching can rectify with no other one, since the camera
moved forward or focal lengths differ much. Elsewhere it gains on shiny sheet and loses completeness (docs/decisions/035
and 078).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mgf_engine.native.library import parallel
from mgf_engine.options.algorithms import parameter
from mgf_engine.scene.depths import Depths
from mgf_engine.scene.kernel_photos import photo_struct
from mgf_engine.scene.neighbours import MatchingPoints, NeighbourOptions
from mgf_engine.scene.stereo import StereoPhoto

REACH = 5  # px from a pixel to the farthest whose plane it tries; as in csrc/stereo/patch_match.c
#: struct Search of csrc/stereo/patch_match.c
SEARCH = [(name, "<f4") for name in ("low", "high", "texture", "contrast", "shift", "tilt", "consistency", "most_off")]
SEARCH += [("inverse_focal", "<f4", 2), ("best", "<i8"), ("seed", "<i8")]  # type: ignore[list-item]
Array = NDArray[np.float32]


@dataclass(frozen=True)
class PatchMatchOptions:
    """Options of PatchMatch stereo."""

    neighbours: int = parameter(5, "Number of photos that each photo is matched with", low=1, high=8)
    rounds: int = parameter(
        0, "Number of rounds, each with half the random changes; 0 for semi-global matching alone, 2 for shiny sheet"
    )
    unmatched_rounds: int = parameter(
        3, "Number of rounds for photos that semi-global matching can match with no other one; 0 for none"
    )
    unmatched_share: float = parameter(
        0.5, "Share of the photos with neighbours from which those that it cannot match are searched", high=1
    )
    unmatched_score: float = parameter(0.6, "Minimum correlation, less that cost, of a depth of such a photo", high=1)
    consistent_rounds: int = parameter(2, "Number of further rounds that compare depths with those of the neighbours")
    best: int = parameter(2, "Number of neighbours, the best correlated ones, that rate a plane", low=1, high=4)
    texture: float = parameter(1.5, "Minimum standard deviation of a patch's brightness", "grey levels")
    contrast: float = parameter(
        20.0, "Difference of brightness at which a pixel of a patch weighs 1/e", "grey levels", low=1e-3
    )
    shift: float = parameter(8.0, "Maximum random change of depth in the first round, as parallax", "px")
    tilt: float = parameter(1.0, "Maximum random change of slope in the first round, as a tangent")
    search_margin: float = parameter(
        0.25, "Search beyond the inverse depths of the sparse points, as a share of their range"
    )
    consistency: float = parameter(0.1, "Correlation that each pixel of distance from a neighbour's depth costs")
    consistency_max_cost: float = parameter(
        3.0, "Distance from a neighbour's depth from which it costs no more (forward-backward reprojection error)", "px"
    )
    consistency_min_ncc: float = parameter(0.4, "Minimum correlation of depths that others are compared with", high=1)
    agreed_score: float = parameter(
        0.3,
        "Minimum correlation, less that cost, of a depth that semi-global matching found, too",
        high=1,
    )
    sure_score: float = parameter(
        1.0, "Minimum correlation, less that cost, of a depth that semi-global matching did not find; 1 for none",
        high=1,
    )  # fmt: skip


@dataclass(frozen=True)
class PixelPlanes:
    """The planes of the wanted pixels of a photo.

    Attributes:
        pixels: y * width + x, int32 [N].
        values: inverse depth in normalised units, its slopes per px to the right and down, and how alike the photos
            look there (-1 to 1), float32 [4, N].
        bounds: least and greatest inverse depth.
    """

    pixels: NDArray[np.int32]
    values: Array
    bounds: tuple[float, float]

    def depth(self, shape: tuple[int, int], least: float) -> Array:
        """Return the depth map [h, w] of the pixels whose score is at least ``least``, 0 elsewhere."""
        result = np.zeros(shape, np.float32)
        sure = self.values[3] >= least
        result.ravel()[self.pixels[sure]] = 1 / self.values[0, sure]
        return result


def improve_depths(
    depths: Depths,
    points: MatchingPoints,
    choice: NeighbourOptions,
    options: PatchMatchOptions,
    check: Callable[[], None],
) -> Depths:
    """Search the planes of all pixels from depth maps by semi-global matching, by default of photos without one.

    Args:
        depths: those maps; photos without neighbours or sparse points keep theirs.
        points: the views of these maps, and the sparse points that choose neighbours and the range of depths.
        choice: of the neighbours.
        options: the search, and which depths count.
        check: called between photos; may raise to cancel.
    """
    near_by = {i: near for i, near in points.neighbours(options.neighbours, choice).items() if near}
    rounds = _rounds(near_by.keys(), depths.maps.keys(), options)
    chosen = {i: near for i, near in near_by.items() if rounds[i]}
    if not chosen:
        return depths
    planes = {}
    for i in chosen:
        check()
        begun = _begin(depths.photos[i], depths.maps.get(i), points.scene.points[points.observed[i]], options, seed=i)
        if begun is not None:
            planes[i] = begun
            _search(depths.photos[i], [depths.photos[j] for j in chosen[i]], None, planes[i], range(rounds[i]), options)
    for k in range(options.consistent_rounds):
        maps = {i: p.depth(depths.photos[i].grey.shape, options.consistency_min_ncc) for i, p in planes.items()}
        maps = {**depths.maps, **maps}
        for i in planes:
            check()
            near = [j for j in chosen[i] if j in maps]
            last = range(rounds[i] // 2 + k, rounds[i] // 2 + k + 1)
            _search(
                depths.photos[i], [depths.photos[j] for j in near], [maps[j] for j in near], planes[i], last, options
            )
    found = {
        i: _choose(p, depths.maps.get(i), depths.photos[i].grey.shape, depths.tolerance, options)
        for i, p in planes.items()
    }
    return replace(depths, neighbours={**depths.neighbours, **chosen}, maps={**depths.maps, **found})


def _rounds(views: Set[int], matched: Set[int], options: PatchMatchOptions) -> dict[int, int]:
    """Return the number of rounds of each view with neighbours, by which of them semi-global matching could match."""
    unmatched = views - matched
    enough = len(unmatched) >= options.unmatched_share * len(views)
    return {i: options.rounds if i in matched else options.unmatched_rounds * enough for i in views}


def _begin(
    photo: StereoPhoto, depth: Array | None, points: NDArray[np.float64], options: PatchMatchOptions, seed: int
) -> PixelPlanes | None:
    """Start from a depth map, and at random where it is unknown; None without sparse points or wanted pixels."""
    z = points @ photo.view.rotation[2] + photo.view.translation[2]
    height, width = photo.grey.shape
    rim = np.zeros((height, width), bool)
    rim[REACH:-REACH, REACH:-REACH] = True
    pixels = np.flatnonzero(photo.inside & rim).astype(np.int32)
    if not (z > 0).any() or not len(pixels):
        return None
    low, high = np.percentile(1 / z[z > 0], [1, 99])
    margin = options.search_margin * (high - low)
    low, high = max(low - margin, low / 2), high + margin
    inverse = np.random.default_rng(seed).uniform(low, high, len(pixels))
    if depth is not None:
        known = depth.ravel()[pixels] > 0
        inverse[known] = 1 / depth.ravel()[pixels[known]]
    values = np.zeros((4, len(pixels)), np.float32)
    values[0], values[3] = np.clip(inverse, low, high), -1
    return PixelPlanes(pixels, values, (float(values[0].min()), float(values[0].max())))


def _search(
    photo: StereoPhoto,
    others: Sequence[StereoPhoto],
    depths: Sequence[Array] | None,
    planes: PixelPlanes,
    rounds: range,
    options: PatchMatchOptions,
) -> None:
    """Move the planes of a photo, one colour of the checkerboard after the other.

    Args:
        photo: the photo.
        others: its neighbours.
        depths: their depth maps, whose distance from a plane costs correlation; None for no such cost.
        planes: changed in place.
        rounds: numbers of the rounds.
        options: the search.
    """
    if not others:
        return
    height, width = photo.grey.shape
    fields = np.zeros((4, height * width), np.float32)
    fields[:, planes.pixels] = planes.values
    color = (planes.pixels % width + planes.pixels // width) % 2
    halves = [np.ascontiguousarray(planes.pixels[color == c]) for c in (0, 1)]
    view, maps = photo.view, depths if depths is not None else [None] * len(others)
    first = photo_struct(view, [(photo.quads, None, view)])
    other = photo_struct(view, [(p.quads, depth, p.view) for p, depth in zip(others, maps, strict=True)])
    for number in rounds:
        for c, half in enumerate(halves):
            search = search_struct(photo, planes.bounds, len(others), number, c, depths is not None, options)
            parallel("mgf_patch_match", len(half), half, first, other, len(others), search, *fields)
    planes.values[:] = fields[:, planes.pixels]


def search_struct(
    photo: StereoPhoto, bounds: tuple[float, float], others: int, number: int, color: int, consistent: bool,
    options: PatchMatchOptions,
) -> NDArray[np.void]:  # fmt: skip
    """Return the options of half a round as the kernel takes them.

    Args:
        photo: as the kernel takes it.
        bounds: least and greatest inverse depth.
        others: number of neighbours.
        number: of the round; steps get shorter with it, and it seeds the random numbers.
        color: 0 or 1, which half of the pixels is searched.
        consistent: whether the neighbours' own depths count.
        options: options of the search.
    """
    search, factor = np.zeros(1, SEARCH), 0.5**number
    search["low"], search["high"] = bounds
    search["texture"], search["contrast"] = options.texture, options.contrast
    search["shift"], search["tilt"] = options.shift * factor, options.tilt * factor
    search["consistency"], search["most_off"] = options.consistency if consistent else 0, options.consistency_max_cost
    search["inverse_focal"] = 1 / photo.view.fx, 1 / photo.view.fy
    search["best"], search["seed"] = min(options.best, others), 2 * number + color
    return search


def _choose(
    planes: PixelPlanes, other: Array | None, shape: tuple[int, int], tolerance: float, options: PatchMatchOptions
) -> Array:
    """Return the depth map [h, w] of the depths that are certain, or that another depth map confirms."""
    if other is None:
        return planes.depth(shape, options.unmatched_score)
    sure, likely = planes.depth(shape, options.sure_score), planes.depth(shape, options.agreed_score)
    agreed = (likely > 0) & (np.abs(likely - other) < tolerance * likely)
    return np.where(agreed, likely, sure)
