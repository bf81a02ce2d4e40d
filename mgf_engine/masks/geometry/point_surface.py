# SPDX-License-Identifier: GPL-3.0-or-later
"""Approximate the surface of sparse points by discs around them and columns below them, and render its depth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.geometry.ground_plane import GroundPlane
from mgf_engine.masks.geometry.overhangs import Overhangs
from mgf_engine.masks.geometry.point_features import PointFeatures
from mgf_engine.masks.image_ops import disc
from mgf_engine.model.scene import Scene, View
from mgf_engine.native.library import call
from mgf_engine.options.algorithms import parameter

Map = NDArray[np.bool_]
Points = NDArray[np.float64]

_RINGS = ((0.5, 6), (1.0, 12))  # share of the disc's radius, samples


@dataclass(frozen=True)
class SurfaceOptions:
    """Options of the surface around points."""

    column: int = parameter(40, "Maximum number of samples between a point and the ground", low=1)
    disc: float = parameter(0.9, "Radius of the disc around a point on a flat surface", "point spacings")
    flat: float = parameter(0.6, "Flatness from which a point has a surface", high=1)
    cell: float = parameter(0.5, "Minimum distance between samples", "point spacings", low=0.01)
    splat: float = parameter(0.8, "Radius of a rendered sample, as a share of the minimum distance between samples")


@dataclass(frozen=True)
class SampledSurface:
    """Samples [M, 3] with the spacing [M] of the points they come from, thinned to cells of one size.

    Attributes:
        cell: normalised units; tolerance: half the points' spacing, by which depths may be off.
        splat: radius of a sample, in cells.
    """

    samples: Points
    spacing: Points
    cell: float
    tolerance: float
    splat: float = SurfaceOptions.splat

    def project(self, view: View, h: int, w: int) -> tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]]:
        """Return map pixels (y * w + x), depths and spacings in map pixels of the samples inside the frame, [N]
        each."""
        count = len(self.samples)
        places, depth, radius = np.empty(count, np.int32), *np.empty((2, count), np.float32)
        unit = float(view.fx * w / view.width)
        given = count, self._columns, self._spacing, _matrix(view, h, w), h, w, unit
        seen = call("mgf_project_samples", *given, places, depth, radius)
        return places[:seen], depth[:seen], radius[:seen]

    @cached_property
    def _columns(self) -> NDArray[np.float32]:
        """The samples as [3, M], contiguous: every photo projects all of them in every round."""
        return np.ascontiguousarray(self.samples.T, np.float32)

    @cached_property
    def _spacing(self) -> NDArray[np.float32]:
        return self.spacing.astype(np.float32)

    def depth(self, view: View, h: int, w: int) -> NDArray[np.float32]:
        """Return the depth at which each map pixel meets the surface first, infinite where it does not, [h, w]."""
        near = self._splat(view, h, w)
        if self.cell > self.tolerance:  # few samples: where they lie unevenly, a pixel between them is missed
            near = np.asarray(cv2.morphologyEx(near, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)), np.float32)
        return near

    def _splat(self, view: View, h: int, w: int) -> NDArray[np.float32]:
        """Return the nearest depth among discs around the samples; infinite where there is none, [h, w]."""
        most = max(0, int(2 * np.log2(max(h, w) / 4)))
        # Discs get larger by the square root of two from one level to the next.
        limits = self.splat * self.cell * view.fx * w / view.width / 2 ** ((np.arange(most) + 0.5) / 2)
        spots = np.full((most + 1, h, w), np.inf, np.float32)
        used = call(
            "mgf_nearest_samples", len(self.samples), self._columns, _matrix(view, h, w), h, w, most + 1,
            limits.astype(np.float32), spots,
        )  # fmt: skip
        result = np.full((h, w), np.inf, np.float32)
        for level in range(most + 1):
            if used >> level & 1:
                kernel = disc(round(2 ** (level / 2)))
                grown = cv2.erode(spots[level], kernel, borderType=cv2.BORDER_CONSTANT, borderValue=float("inf"))
                result = np.minimum(result, grown)
        return result


def _matrix(view: View, h: int, w: int) -> NDArray[np.float32]:
    """Return the matrix from the normalised frame to the pixels of a map of the view, [3, 4]."""
    frame = np.array([[view.fx * w / view.width, 0, view.cx * w / view.width],
                      [0, view.fy * h / view.height, view.cy * h / view.height], [0, 0, 1]])  # fmt: skip
    return np.ascontiguousarray(frame @ np.column_stack([view.rotation, view.translation]), np.float32)


@dataclass(frozen=True)
class Columns:
    """What is below points: columns of samples down to the ground.

    Attributes:
        overhangs: points that have none: discs instead, and what is astray among them is left out.
        ground: where columns end; None: the lowest points around.
    """

    overhangs: Overhangs
    ground: GroundPlane | None


def make_surface(
    scene: Scene,
    features: PointFeatures,
    keep: Map,
    discs: bool,
    columns: Columns | None = None,
    coarse: float = 0.0,
    options: SurfaceOptions = SurfaceOptions(),
) -> SampledSurface:
    """Make the surface around kept points.

    Args:
        scene: sparse points.
        features: spacing, flatness and height of the points.
        keep: bool [P], points of the building.
        discs: add a disc around each point whose neighbours are flat.
        columns: add what is below points; None: nothing.
        coarse: side of the cells, where that is more than half the spacing of the points; finer ones are not seen.
        options: of the samples.
    """
    if not keep.any():
        return SampledSurface(np.zeros((0, 3)), np.zeros(0), 1.0, 1.0, options.splat)
    usual = float(np.median(features.spacing[keep]))
    spacing = np.clip(features.spacing, 0.5 * usual, 2 * usual)
    cell = max(options.cell * usual, coarse)
    owner = np.flatnonzero(keep)
    overhangs = None if columns is None else columns.overhangs
    if overhangs is not None:
        owner = owner[~(overhangs(scene.points[owner]) & features.astray[owner])]
    samples = scene.points[owner]
    flat = owner if discs else owner[overhangs(samples)] if overhangs is not None else owner[:0]
    if len(flat):
        wide, around = _discs(scene.points, spacing, features, flat, options)
        samples, owner = _thin(np.concatenate([samples, wide]), np.concatenate([owner, around]), cell)
    if columns is not None:
        top = _highest(samples, features.up, cell)
        top, ground = top[~columns.overhangs(samples[top])], columns.ground
        height = np.maximum(ground.height(samples[top]), 0) if ground is not None else features.height[owner[top]]
        below, count = _columns(samples[top], height, features.up, cell, options)
        samples = np.concatenate([samples, below])
        samples, owner = _thin(samples, np.concatenate([owner, np.repeat(owner[top], count)]), cell)
    return SampledSurface(samples, spacing[owner], cell, options.cell * usual, options.splat)


def _discs(
    points: Points, spacing: Points, features: PointFeatures, rows: NDArray[np.int64], options: SurfaceOptions
) -> tuple[Points, NDArray[np.int64]]:
    """Sample a disc around each of these points where the surface is flat, and which point each belongs to."""
    flat = rows[features.flatness[rows] > options.flat]
    normals = features.normals[flat]
    helper = np.where(np.abs(normals[:, :1]) < 0.7, [[1.0, 0, 0]], [[0, 1.0, 0]])
    first = np.cross(normals, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(normals, first)
    samples, owner = [], []
    for ring, number in _RINGS:
        for angle in np.arange(number) * (2 * np.pi / number):
            reach = (ring * options.disc * spacing[flat])[:, None]
            samples.append(points[flat] + reach * (np.cos(angle) * first + np.sin(angle) * second))
            owner.append(flat)
    return np.concatenate(samples), np.concatenate(owner)


def _highest(samples: Points, up: Points, cell: float) -> NDArray[np.int64]:
    """Return the highest sample over each cell of the ground: the column below it holds those of all others there,
    [K]."""
    first = np.cross(up, [1.0, 0, 0] if abs(up[0]) < 0.7 else [0, 1.0, 0])
    first /= np.linalg.norm(first)
    flat = np.stack([samples @ first, samples @ np.cross(up, first)], axis=1)
    _, place = np.unique(np.floor(flat / cell).astype(np.int64), axis=0, return_inverse=True)
    place = place.reshape(-1)
    order = np.lexsort((samples @ up, place))
    return order[np.flatnonzero(np.diff(place[order], append=-1))]


def _columns(
    top: Points, height: Points, up: Points, cell: float, options: SurfaceOptions
) -> tuple[Points, NDArray[np.int64]]:
    """Sample columns below the samples [K, 3], down to depths [K]; returns them and their number per sample, [K]."""
    step = np.maximum(cell, height / options.column)
    count = np.floor(height / step).astype(np.int64) + 1
    rank = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    return np.repeat(top, count, axis=0) - (rank * np.repeat(step, count))[:, None] * up, count


def _thin(samples: Points, owner: NDArray[np.int64], cell: float) -> tuple[Points, NDArray[np.int64]]:
    """Keep the first sample of each cell, with its owner."""
    cells = np.floor((samples - samples.min(0)) / cell).astype(np.int64)
    first = _first_of_each(np.ravel_multi_index(tuple(cells.T), tuple(cells.max(0) + 1)))
    return samples[first], owner[first]


def _first_of_each(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Find the first index of each value of keys >= 0, by ascending value: a faster ``np.unique``."""
    bits = len(keys).bit_length()
    if int(keys.max()) >> (63 - bits):
        return np.unique(keys, return_index=True)[1]
    ranked = np.sort(keys << bits | np.arange(len(keys)))
    return ranked[np.flatnonzero(np.diff(ranked >> bits, prepend=-1))] & ((1 << bits) - 1)
