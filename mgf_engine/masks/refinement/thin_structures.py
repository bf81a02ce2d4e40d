# SPDX-License-Identifier: GPL-3.0-or-later
"""Add clicked thin structures (steel frames, masts, railings) to the masks, from their silhouettes against the sky.

A click outside of the masks is either a mistake or a missing part. It is a missing part if clicks in several photos
meet in one structure that stands out against the sky. Its pixels in front of the sky are then building, with columns
down to the ground. In front of the ground, pixels that other photos confirm as ground are background, and pixels that
contrast with such ground are building; in front of anything else, pixels are ignored.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.geometry.ground_plane import GroundPlane
from mgf_engine.masks.image_ops import dilate_square, rgb_to_lab
from mgf_engine.masks.prompts import Prompts
from mgf_engine.masks.refinement.ground_homography import GroundFinder, near_ground
from mgf_engine.masks.refinement.silhouette_hull import SilhouetteHull, SilhouetteHullOptions, carve_silhouette_hull
from mgf_engine.masks.refinement.sky_silhouette import SilhouetteOptions, SkySilhouette, find_silhouette
from mgf_engine.model.masks import BACKGROUND, BUILDING, IGNORE, building
from mgf_engine.model.pixels import pixel_at
from mgf_engine.model.scene import Scene, View
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class ThinStructureOptions:
    """Options of thin structures against the sky."""

    photos: int = parameter(2, "Number of photos in which a part must be clicked", low=1)
    near: int = parameter(3, "Radius around a click", "px")
    leafy: float = parameter(0.5, "Vegetation probability from which a pixel is vegetation", high=1)
    space: float = parameter(4.0, "Side of the searched cube, as a factor of the building's largest extent", low=1)
    cell: float = parameter(3.0, "Side of a cell", "px", low=0.1)
    largest: int = parameter(60, "Maximum number of photos that decide on a cell", low=2)
    silhouette: SilhouetteOptions = SilhouetteOptions()
    hull: SilhouetteHullOptions = SilhouetteHullOptions()


@dataclass(frozen=True)
class SceneContext:
    """A scene and what is known of it besides its masks.

    Attributes:
        scene: photos, cameras and sparse points.
        accepted: [P], sparse points of the building.
        up: [3], normalised frame.
        ground: on which the building stands, if known.
        sky: view -> bool [H, W], regions that are sky.
        leafy: view -> float [H, W], probability of vegetation.
    """

    scene: Scene
    accepted: NDArray[np.bool_]
    up: NDArray[np.float64]
    ground: GroundPlane | None
    sky: Callable[[int], NDArray[np.bool_]]
    leafy: Callable[[int], NDArray[np.float32]]


@dataclass(frozen=True)
class ThinStructures:
    """The parts found, and the clicks they explain as (view, row among the positive clicks)."""

    hull: SilhouetteHull
    outlines: list[SkySilhouette]
    explained: set[tuple[int, int]]

    def draw(self, index: int, view: View, shown: NDArray[np.uint8], ground: GroundFinder | None) -> None:
        """Add the parts to the label map of a photo, in place.

        Args:
            index: number of the photo in the scene.
            view: its camera.
            shown: its label map, uint8 [H, W]; changed.
            ground: finds what shows the ground; None where there is no plane of it.
        """
        covered = self.hull.cover(view) & ~building(shown)
        shown[covered] = IGNORE
        if ground is not None:
            found = ground.find_ground_pixels(index, covered)
            shown[covered & near_ground(found.certain, found.reach) & ~found.possible] = BUILDING
            shown[found.certain] = BACKGROUND
        seen = self.outlines[index]
        shown[covered & seen.empty] = BACKGROUND
        shown[covered & seen.solid] = BUILDING


def find_thin_structures(
    known: SceneContext,
    prompts: Prompts,
    labels: Sequence[NDArray[np.uint8]],
    options: ThinStructureOptions = ThinStructureOptions(),
) -> ThinStructures | None:
    """Find clicked parts of the building against the sky that the masks miss; None if there are none.

    Args:
        known: scene, points of the building, sky and plants.
        prompts: all clicks, outliers too.
        labels: per view uint8 [H, W], as drawn so far.
        options: of the search.
    """
    scene, missed = known.scene, _missed(prompts, labels, options)
    if len({view for view, _, _ in missed}) < options.photos or known.accepted.sum() < 10:
        return None
    outlines = []
    for index, view in enumerate(scene.views):
        lab, sky = rgb_to_lab(scene.photo(index)), known.sky(index)
        seen = find_silhouette(lab, sky, view, known.up, options=options.silhouette)
        unexplained = seen.solid & ~building(labels[index]) & (known.leafy(index) < options.leafy)
        outlines.append(SkySilhouette(seen.empty, unexplained))
    hull = _hull(scene, outlines, known.accepted, options)
    parts = hull.parts()
    wanted, explained = _clicked(scene, hull, parts, missed, options)
    if not wanted:
        return None
    hull = hull.where(np.isin(parts, list(wanted)))
    if known.ground is not None:
        hull = hull.standing(known.ground, options.hull)
    return ThinStructures(hull, outlines, explained)


def _missed(
    prompts: Prompts, labels: Sequence[NDArray[np.uint8]], options: ThinStructureOptions
) -> list[tuple[int, int, NDArray[np.float64]]]:
    """Return positive clicks with no building around them: view, row, pixel."""
    result: list[tuple[int, int, NDArray[np.float64]]] = []
    for index, clicks in prompts.items():
        near = dilate_square(building(labels[index]), options.near)
        outside = ~near[pixel_at(near.shape, clicks.positive)]
        result += [(index, int(row), clicks.positive[row]) for row in np.flatnonzero(outside)]
    return result


def _hull(
    scene: Scene, outlines: Sequence[SkySilhouette], accepted: NDArray[np.bool_], options: ThinStructureOptions
) -> SilhouetteHull:
    """Carve the hull of the unexplained silhouettes around the building."""
    low, high = np.percentile(scene.points[accepted], (1, 99), axis=0)
    centre, size = (low + high) / 2, options.space * float((high - low).max())
    pixel = float(np.median([np.linalg.norm(v.centre - centre) / v.fx for v in scene.views]))
    telling = np.argsort([-int(outline.solid.sum()) for outline in outlines], kind="stable")[: options.largest]
    views = [scene.views[i] for i in telling]
    return carve_silhouette_hull(
        views, [outlines[i] for i in telling], centre - size / 2, size, options.cell * pixel, options.hull
    )


def _clicked(
    scene: Scene,
    hull: SilhouetteHull,
    parts: NDArray[np.int64],
    missed: Sequence[tuple[int, int, NDArray[np.float64]]],
    options: ThinStructureOptions,
) -> tuple[set[int], set[tuple[int, int]]]:
    """Return parts that clicks in enough photos fall on, and those clicks."""
    on: dict[int, set[tuple[int, int]]] = {}
    centres = hull.centres
    for index, row, click in missed:
        uv, depth = scene.views[index].project(centres)
        hit = (depth > 0) & (np.abs(uv - click) <= options.near).all(1)
        for part in np.unique(parts[hit]).tolist():
            on.setdefault(part, set()).add((index, row))
    wanted = {part for part, clicks in on.items() if len({index for index, _ in clicks}) >= options.photos}
    return wanted, {click for part in wanted for click in on[part]}
