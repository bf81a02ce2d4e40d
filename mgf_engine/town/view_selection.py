# SPDX-License-Identifier: GPL-3.0-or-later
"""Which photos see which building, how well, and which of them are worth using."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.rasterize import render_mesh, scaled_view
from mgf_engine.georef.model import Georeference
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import Scene, View
from mgf_engine.town.hulls import Hull, prism, samples
from mgf_engine.town.place import to_normalised

Array = NDArray[np.float64]
#: Longest side of the pictures that hulls are drawn in, pixels.
SIDE = 480
_SPACING, _STEEP, _TOLERANCE = 2.0, 0.17, 0.02  # metres; cosine of 80 degrees; share of a depth
_PARTY = 1.0  # metre: a wall so near to another footprint is shared with it, and nobody sees it
_LEAST_SHARE = 0.008  # of a photo, which a building must fill to be worth it
#: A spot of a building gains this much less by every further photo of it.
_DECAY = 0.82
FEWEST = 3  # photos of a building


@dataclass(frozen=True)
class HullBuffers:
    """The hulls as photos see them.

    Attributes:
        owner: per photo, int16 [H, W]: which hull each pixel sees, -1 for none; pictures of at most :data:`SIDE`.
        depth: per photo, float32 [H, W], normalised frame; 0 where there is none.
        views: the cameras of those pictures.
        factor: per photo, pixels there over pixels of the working photo.
    """

    owner: list[NDArray[np.int16]]
    depth: list[NDArray[np.float32]]
    views: list[View]
    factor: list[float]


@dataclass(frozen=True)
class ViewSelection:
    """The photos of one building.

    Attributes:
        photos: indices of the views, the most telling first.
        share: mean share of a photo that its hull fills, what hides it taken off.
        pixel: size of a pixel on the building in metres, median of the photos.
        seen: share of the spots of walls and roof that two photos or more see.
        candidates: number of photos that see it at all.
    """

    photos: list[int]
    share: float
    pixel: float
    seen: float
    candidates: int


def small_view(view: View) -> tuple[View, float]:
    """The camera with pictures of at most :data:`SIDE`, and their size over that of the working photo."""
    factor = min(1.0, SIDE / max(view.width, view.height))
    return (scaled_view(view, factor) if factor < 1 else view), factor


def draw_hulls(scene: Scene, georeference: Georeference, hulls: Sequence[Hull], metre: float) -> HullBuffers:
    """Draw all hulls into all photos, each hiding what lies behind it."""
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
        small, factor = small_view(view)
        buffers = render_mesh(mesh, small)
        drawn.owner.append(owner_of[buffers.face])
        drawn.depth.append(buffers.depth)
        drawn.views.append(small)
        drawn.factor.append(factor)
    return drawn


def choose_photos(
    scene: Scene,
    georeference: Georeference,
    hull: Hull,
    number: int,
    hulls: Sequence[Hull],
    drawn: HullBuffers,
    most: int,
    metre: float,
) -> ViewSelection:
    """The photos worth using for a hull: together they see as much of it as possible, near and face on.

    Each photo is taken for what it adds to the spots of the hull: the cosine of the angle it sees them under times its
    resolution there, over that of the best photo, less for spots that photos taken before show already.

    Args:
        number: of the hull among ``hulls`` and in ``drawn``.
        most: photos at most.
    """
    low = max(hull.low, hull.low + 0.1 * (hull.high - hull.low))
    spots, normals = samples(hull.polygon, low, hull.high, _SPACING * metre)
    outside = _towards_neighbours(spots + _PARTY * metre * normals, hull, hulls)
    spots, normals = spots[~outside], normals[~outside]
    places = to_normalised(scene, georeference, spots)
    turned = to_normalised(scene, georeference, spots + normals * metre) - places
    length = np.linalg.norm(turned[0])  # of a metre
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    quality = np.zeros((len(scene.views), len(spots)))
    shares = np.zeros(len(scene.views))
    pixels = np.full(len(scene.views), np.inf)
    for index, view in enumerate(scene.views):
        owner, small = drawn.owner[index], drawn.views[index]
        shares[index] = float((owner == number).mean())
        if shares[index] == 0:
            continue
        uv, depth = small.project(places)
        u, v = np.clip(uv, 0, (small.width - 1, small.height - 1)).astype(int).T
        inside = (depth > 0) & (uv >= 0).all(1) & (uv < (small.width, small.height)).all(1)
        met = drawn.depth[index][v, u]
        free = (owner[v, u] == number) | (met == 0) | (depth < met * (1 + _TOLERANCE))
        ray = view.centre - places
        cosine = (ray * turned).sum(1) / np.linalg.norm(ray, axis=1)
        seen = inside & free & (cosine > _STEEP)
        quality[index, seen] = cosine[seen] * view.fx / depth[seen]
        if seen.any():
            pixels[index] = 1.0 / float(np.median(view.fx / depth[seen] * length))
    worth = (shares >= _LEAST_SHARE) & (quality > 0).any(1)
    if not worth.any():
        return ViewSelection([], 0.0, 0.0, 0.0, int((shares > 0).sum()))
    quality = quality / max(float(np.percentile(quality[quality > 0], 90)), 1e-12)
    quality = np.minimum(quality, 1.5) * worth[:, None]
    chosen = list[int]()
    gain = np.ones(len(spots))
    while len(chosen) < min(most, int(worth.sum())):
        value = quality @ gain
        value[chosen] = -1.0
        best = int(np.argmax(value))
        chosen.append(best)
        gain *= np.where(quality[best] > 0, _DECAY, 1.0)
    twice = float(((quality[chosen] > 0).sum(0) >= 2).mean())
    return ViewSelection(
        chosen, float(shares[chosen].mean()), float(np.median(pixels[chosen])), twice, int((shares > 0).sum())
    )


def _towards_neighbours(points: Array, hull: Hull, hulls: Sequence[Hull]) -> NDArray[np.bool_]:
    """Which points [S, 3] (local frame) lie in the footprint of another hull."""
    import shapely

    around = shapely.MultiPoint(points[:, :2]).envelope
    near = [other.polygon for other in hulls if other is not hull and other.polygon.intersects(around)]
    if not near:
        return np.zeros(len(points), bool)
    return np.asarray(shapely.contains_xy(shapely.union_all(near), points[:, :2]))
