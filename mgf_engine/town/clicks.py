# SPDX-License-Identifier: GPL-3.0-or-later
"""Automatic clicks from sparse points and hulls: pixels on a building and beside it, in the photos that show it.

A sparse point is where photos agree, so its track names the very pixels that show it: points on walls and roof are
clicks on the building, points on the ground, on trees and on neighbours are clicks beside it. Where a building has few
points, the inmost part of its hull stands in for them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mgf_engine.geometry.rasterize import render_mesh
from mgf_engine.masks.image_ops import dilate_square
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import Scene
from mgf_engine.options.algorithms import parameter
from mgf_engine.scene.cameras import to_original
from mgf_engine.scene.roots import camera_poses, sample_views
from mgf_engine.town.hulls import BuildingHullOptions, Hull, prism
from mgf_engine.town.view_selection import HullScene, ViewSelection

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class ClickOptions:
    """Options of suggested clicks."""

    positives: int = parameter(5, "Maximum number of clicks on the building in a photo", low=1)
    negatives: int = parameter(5, "Maximum number of clicks beside the building in a photo")
    every: int = parameter(3, "Number of photos for each photo with clicks", low=1)
    photos: int = parameter(5, "Minimum number of photos with clicks", low=1)
    large: float = parameter(0.6, "Size of the building in a photo with clicks, as a share of the median", high=1)
    hidden: int = parameter(10, "Distance to another hull within which a pixel may belong to it", "px")
    inside: float = parameter(3.0, "Minimum distance of clicks inside a hull from its edge", "px")
    outside: float = parameter(4.0, "Minimum distance of clicks beside a hull from its edge", "px")
    near: float = parameter(
        0.25, "Maximum distance of clicks beside a building, as a share of the longest side", high=1
    )
    around: int = parameter(
        8, "Number of points nearest to a point on the building that have to lie all around it", low=2
    )
    open_side: float = parameter(
        100.0, "Maximum angle at such a point within which none of them lies; in the sky it is 180 or more",
        "degrees", high=360,
    )  # fmt: skip
    neighbour: float = parameter(1.0, "Distance to a neighbour within which a point may belong to either", "m")
    hulls: BuildingHullOptions = BuildingHullOptions()


@dataclass(frozen=True)
class PointClasses:
    """Sparse points by where they lie, bool [P] each; those in no class may be on the building or not.

    Attributes:
        on: on the building.
        neighbours: on other buildings.
        beside: beside the building and its neighbours.
    """

    on: Bools
    neighbours: Bools
    beside: Bools


def classify_points(
    hull: Hull, hulls: Sequence[Hull], points: Array, metre: float, options: ClickOptions = ClickOptions()
) -> PointClasses:
    """Classify the sparse points by where they lie relative to one building.

    Args:
        hull: of the building.
        hulls: of all buildings.
        points: sparse points [P, 3], local frame.
        metre: length of a metre in the local frame.
        options: distances.
    """
    slack, above = options.hulls.slack * metre, hull.low + options.hulls.above * metre
    around = hull.polygon.buffer(40 * metre)
    near = shapely.contains_xy(around.envelope, points[:, :2])
    on, next_to, beside = (np.zeros(len(points), bool) for _ in range(3))
    rows = np.flatnonzero(near)
    places, heights = points[rows, :2], points[rows, 2]
    others = [h.polygon for h in hulls if h is not hull and h.polygon.intersects(around)]
    neighbours = shapely.union_all(others) if others else shapely.Polygon()
    inside = shapely.contains_xy(hull.polygon.buffer(0.5 * slack), places)
    to_neighbour = shapely.distance(shapely.points(places), neighbours) if others else np.full(len(rows), np.inf)
    on[rows] = (
        inside & (heights > above) & (heights < hull.high + 0.5 * metre) & (to_neighbour > options.neighbour * metre)
    )
    clear = ~shapely.contains_xy(hull.polygon.buffer(2 * slack), places)
    next_to[rows] = shapely.contains_xy(neighbours, places) & clear & (heights > above)
    # What overhangs a footprint is near it; the ground right at the wall is left to the mask.
    beside[rows] = clear & ~shapely.contains_xy(neighbours.buffer(slack), places)
    return PointClasses(on, next_to, beside)


def suggest_clicks(
    town: HullScene, number: int, choice: ViewSelection, options: ClickOptions = ClickOptions()
) -> dict[str, dict[str, list[list[float]]]]:
    """Suggest clicks on one building in the form of ``prompts.json``, pixels of the user's photos.

    Args:
        town: photos and hulls.
        number: of the building's hull in the town.
        choice: its photos.
        options: number of clicks, and how far they keep from edges.
    """
    if not choice.photos:
        return {}
    scene, drawn, hull = town.scene, town.drawn, town.hulls[number]
    classes = classify_points(hull, town.hulls, town.points, town.metre, options)
    alone = _mesh(town, hull.polygon, hull.low - 0.3 * town.metre, hull.high)
    middle = hull.polygon.buffer(-0.15 * math.sqrt(hull.polygon.area))
    middle = middle if not middle.is_empty else hull.polygon
    core = _mesh(town, middle, hull.low, hull.low + 0.6 * (hull.high - hull.low))
    result: dict[str, dict[str, list[list[float]]]] = {}
    shares = [float((owner == number).mean()) for owner in drawn.owner]
    for index in _choose_clicked(scene, choice, shares, options):
        positive, negative = _clicks_in(town, number, index, classes, alone, core, options)
        if len(positive):
            pixels = {"positive": positive, "negative": np.array(negative)}
            result[scene.views[index].name] = {kind: _to_original(scene, index, at) for kind, at in pixels.items()}
    return result


def _clicks_in(
    town: HullScene, number: int, index: int, classes: PointClasses, alone: Mesh, core: Mesh, options: ClickOptions
) -> tuple[Array, list[Array]]:
    """Choose the clicks in one photo.

    Args:
        town: photos and hulls.
        number: of the building's hull.
        index: of the photo.
        classes: of the sparse points.
        alone: the building's hull, normalised frame.
        core: its inner part.
        options: number of clicks, and how far they keep from edges.

    Returns:
        clicks on the building and beside it, working pixels, [N, 2] and N times [2].
    """
    scene, drawn = town.scene, town.drawn
    rows = scene.observations(index)
    pixels = np.asarray(scene.track_uv[rows], np.float64)
    owner = scene.track_point[rows]
    factor, view = drawn.factor[index], drawn.views[index]
    visible = drawn.owner[index] == number
    inward, outward = _depth(visible), _depth(render_mesh(alone, view).face < 0)
    on = classes.on[owner]
    on[on] = find_enclosed(pixels[on], options)
    free = visible & ~_near_others(drawn.owner[index], number, options)
    spare = _core_pixels(render_mesh(core, view).face >= 0, free, options)
    positive = _choose_positive(*_kept(pixels, on, inward, factor, options.inside), spare, factor, options)
    limit, half, negative = options.near * max(view.width, view.height), options.negatives // 2, list[Array]()
    for wanted, count in ((classes.neighbours, half), (classes.beside, options.negatives - half)):
        found = _kept(pixels, wanted[owner], outward, factor, options.outside, limit)
        negative += _choose_negative(*found, count)
    return positive, negative


def _choose_clicked(scene: Scene, choice: ViewSelection, shares: Sequence[float], options: ClickOptions) -> list[int]:
    """Return the photos that get clicks: a third of those chosen, spread out, none with only a corner of the
    building."""
    count = min(len(choice.photos), max(options.photos, -(-len(choice.photos) // options.every)))
    large = options.large * float(np.median([shares[k] for k in choice.photos]))
    photos = [k for k in choice.photos if shares[k] >= large]
    views = [scene.views[k] for k in photos]
    centres, directions, _ = camera_poses(views, np.zeros(0, np.int32))
    order = np.arange(len(views))[::-1]  # the first photo of the choice has the highest count
    return [photos[k] for k in sample_views(centres, directions, order, count)]


def _mesh(town: HullScene, polygon: object, low: float, high: float) -> Mesh:
    """Make the prism of a polygon (local frame) between two heights, normalised frame."""
    vertices, faces = prism(polygon, low, high)
    vertices = town.normalised(vertices)
    return Mesh(vertices, faces, np.zeros(vertices.shape, np.uint8))


def _depth(region: Bools) -> NDArray[np.float32]:
    """Compute the distance of the pixels of a region from its edge, 0 outside; the frame's border counts as outside."""
    padded = np.pad(region, 1).astype(np.uint8)
    return np.asarray(cv2.distanceTransform(padded, cv2.DIST_L2, 3)[1:-1, 1:-1], np.float32)


def _kept(
    pixels: Array, wanted: Bools, depth: NDArray[np.float32], factor: float, least: float, most: float = math.inf
) -> tuple[Array, Array]:
    """Return the wanted observations [N, 2] (working pixels) that lie deep enough in a region, and how deep [N]."""
    chosen = pixels[wanted]
    u, v = (chosen * factor).astype(int).T if len(chosen) else np.zeros((2, 0), int)
    found = depth[np.minimum(v, depth.shape[0] - 1), np.minimum(u, depth.shape[1] - 1)]
    kept = (found >= least) & (found <= most)
    return chosen[kept], np.asarray(found[kept], np.float64)


def find_enclosed(pixels: Array, options: ClickOptions) -> Bools:
    """Tell which points on a building [N, 2] others enclose, [N].

    Where a gable or a corner stands before the sky, points of wrong matches and of large features lie beside it, within
    the hull, which is higher: all others then lie on one side of them.
    """
    count = min(options.around, len(pixels) - 1)
    if count < 2:
        return np.zeros(len(pixels), bool)
    _, near = cKDTree(pixels).query(pixels, k=count + 1)
    toward = pixels[near[:, 1:]] - pixels[:, None]
    angle = np.sort(np.arctan2(toward[..., 1], toward[..., 0]), axis=1)
    gap = np.diff(angle, axis=1, append=angle[:, :1] + 2 * np.pi).max(1)
    return np.asarray(gap <= np.radians(options.open_side))


def _core_pixels(core: Bools, visible: Bools, options: ClickOptions) -> tuple[Array, Array]:
    """Return the inmost visible pixels of the core of a hull.

    Returns:
        pixels of the drawn picture [N, 2], and their distances from the edge of the visible core [N].
    """
    depth = _depth(core & visible)
    if depth.max() < options.inside:
        return np.zeros((0, 2)), np.zeros(0)
    v, u = np.nonzero(depth >= max(options.inside, 0.5 * float(depth.max())))
    return np.stack([u, v], 1).astype(np.float64) + 0.5, np.asarray(depth[v, u], np.float64)


def _near_others(owner: NDArray[np.int16], number: int, options: ClickOptions) -> Bools:
    """Return pixels near another hull: a footprint half a metre off, or a roof higher than thought, may put it
    there."""
    return dilate_square((owner >= 0) & (owner != number), options.hidden)


def _choose_positive(
    pixels: Array, depth: Array, spare: tuple[Array, Array], factor: float, options: ClickOptions
) -> Array:
    """Choose clicks on the building: the deepest pixel, then those farthest from the chosen ones; [K, 2].

    Args:
        pixels: of sparse points on the building, working pixels [N, 2].
        depth: distance of each from the edge of the hull, [N].
        spare: further pixels (of the drawn picture) and depths, used if there are too few.
        factor: pixels of the drawn picture per working pixel.
        options: number of clicks.
    """
    if len(pixels) < options.positives and len(spare[0]):
        pixels = np.concatenate([pixels, spare[0] / factor])
        depth = np.concatenate([depth, spare[1]])
    if not len(pixels):
        return pixels
    chosen = [int(np.argmax(depth))]
    gap = np.linalg.norm(pixels - pixels[chosen[0]], axis=1)
    while len(chosen) < options.positives and gap.max() > 6 / factor:
        chosen.append(int(np.argmax(gap * np.minimum(1.0, depth / (4 * options.inside)))))
        gap = np.minimum(gap, np.linalg.norm(pixels - pixels[chosen[-1]], axis=1))
    return pixels[chosen]


def _choose_negative(pixels: Array, depth: Array, count: int) -> list[Array]:
    """Choose clicks beside the building: the nearest pixel, then those that are near it and far from each other."""
    if not len(pixels) or count < 1:
        return []
    chosen = [int(np.argmin(depth))]
    gap = np.linalg.norm(pixels - pixels[chosen[0]], axis=1)
    while len(chosen) < count and gap.max() > 0:
        chosen.append(int(np.argmax(gap / (depth + 10.0))))
        gap = np.minimum(gap, np.linalg.norm(pixels - pixels[chosen[-1]], axis=1))
    return list(pixels[chosen])


def _to_original(scene: Scene, index: int, pixels: Array) -> list[list[float]]:
    """Convert working pixels [N, 2] to pixels of the user's photo, rounded for ``prompts.json``."""
    if not len(pixels):
        return []
    view = scene.views[index]
    found = np.clip(to_original(view, pixels), 0, (view.original_width, view.original_height))
    return [[round(float(u), 1), round(float(v), 1)] for u, v in found]
