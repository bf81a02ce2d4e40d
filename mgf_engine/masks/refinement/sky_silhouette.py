# SPDX-License-Identifier: GPL-3.0-or-later
"""Silhouettes of thin structures against the sky, pixel by pixel, and the visual hull of these silhouettes.

Open steelwork, railings and masts are thinner than superpixels and have no sparse points. But they stand out against
the sky, and the silhouettes of several photos give their position in space.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.components import label_components
from mgf_engine.masks.geometry.ground_plane import GroundPlane
from mgf_engine.masks.image_ops import color_distance, erode_square
from mgf_engine.model.scene import View
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class SilhouetteOptions:
    """Options of silhouettes against the sky."""

    sky_distance: float = parameter(
        5.0, "Colour distance (CIELAB) to the sky around below which a pixel is sky; twice that is something else"
    )
    sky_spread: float = parameter(1.5, "Minimum of sky_distance, as a multiple of the 95th percentile within the sky")
    shrink: int = parameter(4, "Factor by which the photo is reduced for the sky's colour, at least", low=1)
    reduced_side: int = parameter(190, "Longest side of the reduced photo", "px", low=16)
    photos: int = parameter(3, "Number of photos that must show a cell in front of the sky", low=1)
    photo_share: float = parameter(
        0.25, "Minimum share of the photos with a silhouette that must show a cell in front of the sky", high=1
    )
    most_cells: int = parameter(3000000, "Maximum number of cells of the hull", low=8)
    widths: tuple[float, float] = parameter(
        (0.03, 0.1), "Widths of the means of the sky's colour, the second where the first finds none, share of the side"
    )
    horizon: float = parameter(1.5, "Elevation from which nothing can be ground", "degrees", low=-90, high=90)
    feet: float = parameter(0.25, "Share of a hull's cells, the lowest, that stand on something", high=1)


@dataclass(frozen=True)
class SkySilhouette:
    """One photo over the horizon, bool [H, W] each: certain sky, and what certainly is not sky."""

    empty: NDArray[np.bool_]
    solid: NDArray[np.bool_]


def find_silhouette(
    lab: NDArray[np.float32],
    sky: NDArray[np.bool_],
    view: View,
    up: NDArray[np.float64],
    options: SilhouetteOptions = SilhouetteOptions(),
) -> SkySilhouette:
    """Tell sky from what stands before it, over the horizon of the photo.

    Args:
        lab: CIELAB [H, W, 3], see :func:`mgf_engine.masks.image_ops.rgb_to_lab`; sky: [H, W], regions that are
            sky; up: [3], normalised frame.
        view: camera of the photo.
        options: elevation above which silhouettes are found, and colour distances of the sky and of what is before it.
    """
    over = over_horizon(view, up, options.horizon)
    sure = erode_square(sky, 2)
    if not (sure & over).any():
        return SkySilhouette(np.zeros_like(sky), np.zeros_like(sky))
    around, known = _sky_around(lab, sure, options)
    away = color_distance(lab, around)
    most = max(options.sky_distance, options.sky_spread * float(np.percentile(away[sure], 95)))
    return SkySilhouette(over & known & (away < most), over & known & (away > 2 * most))


def over_horizon(view: View, up: NDArray[np.float64], degrees: float = SilhouetteOptions.horizon) -> NDArray[np.bool_]:
    """Return pixels whose rays rise by more than so much, [H, W]: no level ground is seen there."""
    rise, length = _rays(view, up)
    return np.asarray(rise > np.sin(np.radians(degrees)) * length, bool)


def elevation(view: View, up: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return degrees over the horizon of each pixel's ray, [H, W]."""
    rise, length = _rays(view, up)
    return np.asarray(np.degrees(np.arcsin(np.clip(rise / length, -1, 1))), np.float64)


def _rays(view: View, up: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compute the rise of each pixel's ray at depth 1, and its length there, [H, W] each."""
    x, y = view.pixel_rays()
    normal = view.rotation @ up
    rise = normal[0] * x[None, :] + normal[1] * y[:, None] + normal[2]
    return rise, np.sqrt(1 + x[None, :] ** 2 + y[:, None] ** 2)


def _sky_around(
    lab: NDArray[np.float32], sure: NDArray[np.bool_], options: SilhouetteOptions
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the colour of the sky around each pixel [H, W, 3], and where there is any, [H, W]."""
    height, width = sure.shape
    factor = max(options.shrink, max(height, width) // options.reduced_side)
    size = (max(1, width // factor), max(1, height // factor))
    weight = cv2.resize(sure.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    color = cv2.resize(lab * sure[..., None], size, interpolation=cv2.INTER_AREA)
    mean, total = np.zeros_like(color), np.zeros_like(weight)
    for share in options.widths:
        sigma = max(1.0, share * max(size))
        near = cv2.GaussianBlur(weight, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
        new = (total <= 1e-3) & (near > 1e-3)
        blurred = cv2.GaussianBlur(color, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
        mean[new] = (blurred / np.maximum(near, 1e-6)[..., None])[new]
        total[new] = near[new]
    wide = cv2.resize(mean, (width, height), interpolation=cv2.INTER_LINEAR)
    known = cv2.resize((total > 1e-3).astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST) > 0
    return np.asarray(wide, np.float32), known


@dataclass(frozen=True)
class SilhouetteHull:
    """Cells of the visual hull: integer indices [N, 3], the corner of cell 0 and the side of the cells."""

    places: NDArray[np.int64]
    corner: NDArray[np.float64]
    side: float

    @property
    def centres(self) -> NDArray[np.float64]:
        """Normalised frame, [N, 3]."""
        return self.corner + (self.places + 0.5) * self.side

    def parts(self) -> NDArray[np.int64]:
        """Return the number of the connected part each cell belongs to (26 neighbours), [N]."""
        count = len(self.places)
        if not count:
            return np.zeros(0, np.int64)
        span = int(self.places.max()) + 3
        keys = (self.places[:, 0] * span + self.places[:, 1]) * span + self.places[:, 2]
        order = np.argsort(keys)
        ranked, first, second = keys[order], [], []
        for step in _HALF_AROUND:
            wanted = keys + (step[0] * span + step[1]) * span + step[2]
            at = np.minimum(np.searchsorted(ranked, wanted), count - 1)
            hit = np.flatnonzero(ranked[at] == wanted)
            first.append(hit)
            second.append(order[at[hit]])
        return label_components(count, np.concatenate(first), np.concatenate(second)).astype(np.int64)

    def where(self, keep: NDArray[np.bool_]) -> SilhouetteHull:
        """Return the cells that are kept, [N] bool."""
        return SilhouetteHull(self.places[keep], self.corner, self.side)

    def standing(self, ground: GroundPlane, options: SilhouetteOptions = SilhouetteOptions()) -> SilhouetteHull:
        """Return the hull with columns from its lowest cells to the ground, which no photo shows against the sky."""
        height = ground.height(self.centres)
        lowest = height < np.quantile(height, options.feet)
        feet, height = self.centres[lowest], height[lowest]
        below = np.arange(1, np.ceil(height.max(initial=0) / self.side) + 1)
        over = height[:, None] - below * self.side > -self.side / 2
        spots = (feet[:, None] - (below * self.side)[:, None] * ground.normal)[over]
        columns = np.floor((spots - self.corner) / self.side).astype(np.int64)
        return SilhouetteHull(np.unique(np.concatenate([self.places, columns]), axis=0), self.corner, self.side)

    def cover(self, view: View) -> NDArray[np.bool_]:
        """Return pixels of a view behind some cell, [H, W]."""
        result = np.zeros((view.height, view.width), np.uint8)
        uv, depth = view.project(self.centres)
        seen = (depth > self.side) & (uv > -0.5).all(1) & (uv[:, 0] < view.width) & (uv[:, 1] < view.height)
        if not seen.any():
            return result > 0
        x, y = np.maximum(np.floor(uv[seen]), 0).astype(np.int64).T
        result[y, x] = 1
        width = int(np.ceil(view.fx * self.side / float(np.median(depth[seen]))))
        return np.asarray(cv2.dilate(result, np.ones((width | 1, width | 1), np.uint8)) > 0, bool)


_AROUND = [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)]
_HALF_AROUND = [step for step in _AROUND if step > (0, 0, 0)]
_EIGHT = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.int64)


def carve(
    views: Sequence[View],
    outlines: Sequence[SkySilhouette],
    corner: NDArray[np.float64],
    size: float,
    cell: float,
    options: SilhouetteOptions = SilhouetteOptions(),
) -> SilhouetteHull:
    """Carve a cube: keep the cells inside the silhouettes of several photos that hardly any photo shows as sky.

    Cells are subdivided as an octree while they may be solid, so that empty space is cheap.

    Args:
        views: cameras of the photos.
        outlines: one per view; photos without anything solid have no say.
        corner: lowest corner of the cube, normalised frame, [3]; size: its side.
        cell: the side down to which cells are divided.
        options: how many photos must see a cell as something, and how many may see it as sky.
    """
    summed = [(v, _sums(o.empty), _sums(o.solid)) for v, o in zip(views, outlines, strict=True) if o.solid.any()]
    hull = SilhouetteHull(np.zeros((1, 3), np.int64), corner, size)
    while True:
        hull = hull.where(_may_be_solid(hull, summed, options))
        if hull.side <= cell or len(hull.places) * 8 > options.most_cells or not len(hull.places):
            return hull
        hull = SilhouetteHull((2 * hull.places[:, None] + _EIGHT).reshape(-1, 3), corner, hull.side / 2)


def _may_be_solid(
    hull: SilhouetteHull,
    summed: Sequence[tuple[View, NDArray[np.int32], NDArray[np.int32]]],
    options: SilhouetteOptions,
) -> NDArray[np.bool_]:
    centres, radius = hull.centres, hull.side * np.sqrt(3) / 2
    fewest = max(options.photos, round(options.photo_share * len(summed)))
    free, solid, seen = (np.zeros(len(centres), np.int32) for _ in range(3))
    for view, empty_sums, solid_sums in summed:
        uv, depth = view.project(centres)
        before = depth > 2 * radius
        reach = max(view.fx, view.fy) * radius / np.where(before, depth, 1)
        frame = np.array([view.width, view.height])
        low = np.floor(np.where(before[:, None], uv - reach[:, None], 0)).clip(-1, frame + 1).astype(np.int64)
        high = np.ceil(np.where(before[:, None], uv + reach[:, None], 0)).clip(-1, frame + 1).astype(np.int64)
        inside = before & (low >= 0).all(1) & (high <= frame).all(1)
        low, high = low.clip(0, frame), high.clip(0, frame)
        area = (high - low).prod(1)
        sky = inside & (_within(empty_sums, low, high) == area)
        something = _within(solid_sums, low, high) > 0
        free += sky
        solid += (before & something) | (np.abs(depth) <= 2 * radius)
        seen += inside & (sky | something)
    return np.asarray((free <= 1) & (solid >= np.maximum(fewest, 0.5 * seen)), bool)


def _sums(mask: NDArray[np.bool_]) -> NDArray[np.int32]:
    return np.asarray(cv2.integral(mask.astype(np.uint8)), np.int32)


def _within(sums: NDArray[np.int32], low: NDArray[np.int64], high: NDArray[np.int64]) -> NDArray[np.int32]:
    """Return marked pixels in boxes, from summed areas."""
    (x0, y0), (x1, y1) = low.T, high.T
    return np.asarray(sums[y1, x1] - sums[y0, x1] - sums[y1, x0] + sums[y0, x0], np.int32)
