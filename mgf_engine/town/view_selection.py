# SPDX-License-Identifier: GPL-3.0-or-later
"""Select the photos for each building by visibility and size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from mgf_engine.geometry.rasterize import render_mesh, scaled_view
from mgf_engine.georef.model import Georeference
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import Scene, View
from mgf_engine.options.algorithms import parameter
from mgf_engine.town.hulls import Hull, prism, sample_prism
from mgf_engine.town.place import to_normalised

Array = NDArray[np.float64]
MIN_BUILDING_PHOTOS = 3  # photos of a building


@dataclass(frozen=True)
class BuildingViewOptions:
    """Options of the choice of photos."""

    picture_side: int = parameter(480, "Longest side of the pictures that hulls are drawn in", "px", low=64)
    spacing: float = parameter(2.0, "Distance between the spots of a hull whose visibility is tested", "m", low=0.1)
    steep: float = parameter(0.17, "Smallest cosine between a wall's normal and the viewing ray", high=1)
    depth_tolerance: float = parameter(0.02, "Relative depth by which a spot may lie behind what was drawn", high=1)
    party_wall: float = parameter(1.0, "Distance to another footprint within which nobody sees a wall", "m")
    least_share: float = parameter(0.008, "Minimum share of a photo that a building fills", high=1)
    decay: float = parameter(0.82, "Factor on the worth of a spot for each photo that shows it already", high=1)


@dataclass(frozen=True)
class HullBuffers:
    """The hulls as photos see them.

    Attributes:
        owner: per photo, int16 [H, W]: which hull each pixel sees, -1 for none; pictures of at most ``picture_side``.
        depth: per photo, float32 [H, W], normalised frame; 0 where there is none.
        views: the cameras of those pictures.
        factor: per photo, pixels there over pixels of the working photo.
    """

    owner: list[NDArray[np.int16]]
    depth: list[NDArray[np.float32]]
    views: list[View]
    factor: list[float]


@dataclass(frozen=True)
class HullScene:
    """The photos of a town with the hulls of all its buildings.

    Attributes:
        scene: photos and cameras.
        georeference: scene frame to local frame.
        metre: length of a metre in the local frame.
        points: [P, 3] sparse points, local frame.
        hulls: of the buildings, local frame.
        drawn: the hulls as the photos see them.
    """

    scene: Scene
    georeference: Georeference
    metre: float
    points: Array
    hulls: Sequence[Hull]
    drawn: HullBuffers

    @classmethod
    def draw(
        cls,
        scene: Scene,
        georeference: Georeference,
        metre: float,
        points: Array,
        hulls: Sequence[Hull],
        options: BuildingViewOptions = BuildingViewOptions(),
    ) -> HullScene:
        """Draw the hulls into the photos.

        Args:
            scene: photos and cameras.
            georeference: scene frame to local frame.
            metre: length of a metre in the local frame.
            points: [P, 3] sparse points, local frame.
            hulls: of the buildings, local frame.
            options: size of the maps.
        """
        drawn = draw_hulls(scene, georeference, hulls, metre, options)
        return cls(scene, georeference, metre, points, hulls, drawn)

    def normalised(self, points: Array) -> Array:
        """Convert points [N, 3] of the local frame to the normalised frame."""
        return to_normalised(self.scene, self.georeference, points)


@dataclass(frozen=True)
class ViewSelection:
    """The photos of one building.

    Attributes:
        photos: indices of the views in the order of choice: the one that shows most first.
        share: mean share of a photo that the visible part of its hull fills.
        pixel: size of a pixel on the building in metres, median of the photos.
        seen: share of the spots of walls and roof that two photos or more see.
        candidates: number of photos that see it at all.
    """

    photos: list[int]
    share: float
    pixel: float
    seen: float
    candidates: int


def small_view(view: View, options: BuildingViewOptions = BuildingViewOptions()) -> tuple[View, float]:
    """Return the camera with pictures of at most ``picture_side``, and their size over that of the working photo."""
    factor = min(1.0, options.picture_side / max(view.width, view.height))
    return (scaled_view(view, factor) if factor < 1 else view), factor


def draw_hulls(
    scene: Scene,
    georeference: Georeference,
    hulls: Sequence[Hull],
    metre: float,
    options: BuildingViewOptions = BuildingViewOptions(),
) -> HullBuffers:
    """Draw all hulls into all photos, each hiding what lies behind it.

    Args:
        scene: photos and cameras.
        georeference: scene frame to local frame.
        hulls: of the buildings, local frame.
        metre: length of a metre in the local frame.
        options: size of the maps.
    """
    vertices, faces, owners, count = [], [], [], 0
    for number, hull in enumerate(hulls):
        points, triangles = prism(hull.polygon, hull.low - 0.3 * metre, hull.high)
        vertices.append(to_normalised(scene, georeference, points))
        faces.append(triangles + count)
        owners.append(np.full(len(triangles), number))
        count += len(points)
    corners = np.concatenate(vertices)
    mesh = Mesh(corners, np.concatenate(faces).astype(np.int32), np.zeros(corners.shape, np.uint8))
    owner_of = np.concatenate([*owners, [-1]]).astype(np.int16)  # face -1 finds the last
    drawn = HullBuffers([], [], [], [])
    for view in scene.views:
        small, factor = small_view(view, options)
        buffers = render_mesh(mesh, small)
        drawn.owner.append(owner_of[buffers.face])
        drawn.depth.append(buffers.depth)
        drawn.views.append(small)
        drawn.factor.append(factor)
    return drawn


def choose_photos(
    town: HullScene, number: int, most: int, options: BuildingViewOptions = BuildingViewOptions()
) -> ViewSelection:
    """Choose the photos worth using for a hull: together they see as much of it as possible, near and face on.

    Photos are chosen greedily by what each adds: the sum over the spots of the hull that it shows of the cosine of the
    viewing angle times its resolution there, relative to the best photo, and less for spots already shown.

    Args:
        town: photos and hulls.
        number: of the hull in the town.
        most: photos at most.
        options: spots of the hull, and what a photo must show of them.
    """
    hull, metre = town.hulls[number], town.metre
    low = max(hull.low, hull.low + 0.1 * (hull.high - hull.low))
    spots, normals = sample_prism(hull.polygon, low, hull.high, options.spacing * metre)
    outside = _inside_neighbours(spots + options.party_wall * metre * normals, hull, town.hulls)
    if not outside.all():  # else it is part of another building, such as its tower
        spots, normals = spots[~outside], normals[~outside]
    places = town.normalised(spots)
    turned = town.normalised(spots + normals * metre) - places
    seen = _measure_visibility(town.scene, town.drawn, number, places, turned, options)
    candidates = int((seen.shares > 0).sum())
    worth = (seen.shares >= options.least_share) & (seen.quality > 0).any(1)
    if not worth.any():
        return ViewSelection([], 0.0, 0.0, 0.0, candidates)
    quality = seen.quality / max(float(np.percentile(seen.quality[seen.quality > 0], 90)), 1e-12)
    quality = np.minimum(quality, 1.5) * worth[:, None]
    chosen = _choose_greedily(quality, min(most, int(worth.sum())), options.decay)
    twice = float(((quality[chosen] > 0).sum(0) >= 2).mean())
    return ViewSelection(
        chosen, float(seen.shares[chosen].mean()), float(np.median(seen.pixels[chosen])), twice, candidates
    )


@dataclass(frozen=True)
class _Visibility:
    """What the photos show of a hull.

    Attributes:
        quality: how well each photo sees each spot, 0 where it does not, [V, S].
        shares: share of each photo that the hull fills, [V].
        pixels: size of a pixel on the hull in metres, infinite where the photo sees no spot, [V].
    """

    quality: Array
    shares: Array
    pixels: Array


def _measure_visibility(
    scene: Scene, drawn: HullBuffers, number: int, places: Array, turned: Array, options: BuildingViewOptions
) -> _Visibility:
    """Measure how well each photo sees the spots of a hull.

    Args:
        scene: photos and cameras.
        drawn: the hulls as the photos see them.
        number: of the hull.
        places: of the spots, normalised frame, [S, 3].
        turned: their normals, a metre long, [S, 3].
        options: steepest angle and tolerance of the depth.
    """
    length = np.linalg.norm(turned[0])  # of a metre
    normals = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    count = len(scene.views)
    seen = _Visibility(np.zeros((count, len(places))), np.zeros(count), np.full(count, np.inf))
    for index, view in enumerate(scene.views):
        owner, small = drawn.owner[index], drawn.views[index]
        seen.shares[index] = float((owner == number).mean())
        if seen.shares[index] == 0:
            continue
        uv, depth, inside = small.project_into_frame(places)
        u, v = np.clip(uv, 0, (small.width - 1, small.height - 1)).astype(int).T
        met = drawn.depth[index][v, u]
        free = (owner[v, u] == number) | (met == 0) | (depth < met * (1 + options.depth_tolerance))
        ray = view.centre - places
        cosine = (ray * normals).sum(1) / np.linalg.norm(ray, axis=1)
        shown = inside & free & (cosine > options.steep)
        seen.quality[index, shown] = cosine[shown] * view.fx / depth[shown]
        if shown.any():
            seen.pixels[index] = 1.0 / float(np.median(view.fx / depth[shown] * length))
    return seen


def _choose_greedily(quality: Array, count: int, decay: float) -> list[int]:
    """Choose ``count`` photos greedily by what each adds; a spot that a photo shows counts less for the next ones.

    Args:
        quality: how well each photo shows each spot, [V, S].
        count: number of photos.
        decay: factor on the gain of a spot for each photo that shows it.
    """
    chosen = list[int]()
    gain = np.ones(quality.shape[1])
    while len(chosen) < count:
        value = quality @ gain
        value[chosen] = -1.0
        best = int(np.argmax(value))
        chosen.append(best)
        gain *= np.where(quality[best] > 0, decay, 1.0)
    return chosen


def _inside_neighbours(points: Array, hull: Hull, hulls: Sequence[Hull]) -> NDArray[np.bool_]:
    """Tell which points [S, 3] (local frame) lie in the footprint of another hull, bool [S]."""
    around = shapely.MultiPoint(points[:, :2]).envelope
    near = [other.polygon for other in hulls if other is not hull and other.polygon.intersects(around)]
    if not near:
        return np.zeros(len(points), bool)
    return np.asarray(shapely.contains_xy(shapely.union_all(near), points[:, :2]))
