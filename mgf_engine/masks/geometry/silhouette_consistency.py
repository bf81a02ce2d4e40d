# SPDX-License-Identifier: GPL-3.0-or-later
"""Silhouette consistency of regions with all other photos (after Campbell et al. 2010).

Each cell of a box around the building is rated by the share of the photos whose silhouettes contain it. A region whose
rays hit no cell with a high share cannot be the building, whatever its colour; one whose rays hit a cell inside nearly
all silhouettes probably is. This needs no points on the walls.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.boxes import grid_points, percentile_box
from mgf_engine.masks.geometry.ground_plane import GroundPlane
from mgf_engine.masks.propagation.superpixels import Superpixels
from mgf_engine.model.scene import View
from mgf_engine.native.parallel import parallel_map
from mgf_engine.options.algorithms import parameter

Array = NDArray[np.float32]


@dataclass(frozen=True)
class SilhouetteConsistencyOptions:
    """Options of the silhouettes' evidence; odds are natural logarithms of the odds of "building"."""

    cells: int = parameter(96, "Number of cells along the longest side of the box", low=8)
    padding: float = parameter(0.2, "Space around the points of the building, as a share of the longest side")
    percentiles: tuple[float, float] = parameter(
        (0.5, 99.5), "Percentiles of the building's points that bound the box", high=100
    )
    softness: float = parameter(
        0.4, "Width of the range of probability, around a half, in which a region is neither in nor out", low=0.01
    )
    plants: tuple[float, float] = parameter(
        (0.25, 0.75),
        "Similarity to plants between which a region counts less and less: it may hide the building",
        high=1,
    )
    least_views: int = parameter(3, "Minimum number of other photos that must have a cell in their frame", low=1)
    shares: tuple[float, float, float] = parameter(
        (0.7, 0.9, 0.99),
        "Shares of the photos around a cell: against the building, neutral, and for the building",
        high=1,
    )
    odds_against: float = parameter(-3.0, "Log-odds at the first of the shares", low=None)
    odds_for: float = parameter(1.0, "Log-odds at the last of the shares", low=None)
    carved: float = parameter(0.3, "Share of the photos below which a cell is not looked at again", high=1)


@dataclass(frozen=True)
class Silhouette:
    """Soft silhouette of the building in one photo: how far each region is building, and how much that counts.

    Attributes:
        view, regions: the camera, and ``S`` superpixels.
        inside: 0..1, [S].
        weight: 0..1, [S]; 0 for what may hide the building.
    """

    view: View
    regions: Superpixels
    inside: Array
    weight: Array


def silhouette_odds(
    silhouettes: Sequence[Silhouette],
    points: NDArray[np.float64],
    ground: GroundPlane | None,
    threads: int = 1,
    options: SilhouetteConsistencyOptions = SilhouetteConsistencyOptions(),
) -> list[NDArray[np.float64]]:
    """Compute the log-odds of "building" that the other photos' silhouettes give to the regions of each photo.

    Args:
        silhouettes: of all photos that are looked at.
        points: that are probably the building, [N, 3]; the box lies around them.
        ground: what lies below it is not looked at; None without ground.
        threads: number of worker threads.
        options: options.

    Returns:
        [S] for each photo.
    """
    cells, size = _cells(points, ground, options)
    total, count = np.zeros(len(cells), np.float32), np.zeros(len(cells), np.float32)
    for inside, weight in parallel_map(lambda s: _sample(s, cells), silhouettes, threads):
        total += inside * weight
        count += weight
    kept = total >= options.carved * count
    cells, total, count = cells[kept], total[kept], count[kept]

    def odds(silhouette: Silhouette) -> NDArray[np.float64]:
        inside, weight = _sample(silhouette, cells)
        others = count - weight
        share = (total - inside * weight) / np.maximum(others, 1e-6)
        share[others < options.least_views] = options.shares[1]
        largest = _largest_in_regions(silhouette, cells, share, size)
        return np.interp(largest, options.shares, (options.odds_against, 0.0, options.odds_for))

    return list(parallel_map(odds, silhouettes, threads))


def _cells(
    points: NDArray[np.float64], ground: GroundPlane | None, options: SilhouetteConsistencyOptions
) -> tuple[NDArray[np.float64], float]:
    """Return the centres [N, 3] of the box's cells above the ground, and their size."""
    low, high = percentile_box(points, options.percentiles, options.padding)
    size = max(float((high - low).max()) / options.cells, 1e-9)
    axes = [np.arange(a + size / 2, b, size) for a, b in zip(low, high, strict=True)]
    cells = grid_points(*axes)
    return cells if ground is None else cells[ground.height(cells) > -size / 2], size


def _sample(silhouette: Silhouette, cells: NDArray[np.float64]) -> tuple[Array, Array]:
    """Look up ``inside`` and ``weight`` of the region that a cell [N, 3] projects to, 0 out of the frame; [N] each."""
    view = silhouette.view
    uv, _, framed = view.project_into_frame(cells)
    inside, weight = np.zeros(len(cells), np.float32), np.zeros(len(cells), np.float32)
    region = silhouette.regions.at(uv[framed])
    inside[framed], weight[framed] = silhouette.inside[region], silhouette.weight[region]
    return inside, weight


def _largest_in_regions(silhouette: Silhouette, cells: NDArray[np.float64], share: Array, size: float) -> Array:
    """Return the mean over each region of the largest share that its pixels' rays meet, [S]."""
    view, regions = silhouette.view, silhouette.regions
    h, w = regions.labels.shape
    uv, depth = view.project(cells)
    x, y = np.floor(uv * regions.scale).T
    with np.errstate(divide="ignore", invalid="ignore"):
        radius = np.ceil(0.5 * size * view.fx * regions.scale[0] / depth)
    shown = (depth > 0) & (x >= -radius) & (y >= -radius) & (x < w + radius) & (y < h + radius)
    shown &= radius <= max(h, w)  # else the camera stands in the cell
    x, y, radius, share = (values[shown] for values in (x, y, radius, share))
    largest = _largest_of_squares((h, w), x.astype(np.int64), y.astype(np.int64), radius.astype(np.int64), share)
    label, count = regions.labels.ravel(), len(regions.area)
    pixels = np.maximum(np.bincount(label, minlength=count), 1)
    return np.asarray(np.bincount(label, largest.ravel(), minlength=count) / pixels, np.float32)


def _largest_of_squares(
    shape: tuple[int, int], x: NDArray[np.int64], y: NDArray[np.int64], radius: NDArray[np.int64], value: Array
) -> Array:
    """Return the largest value of the squares over each pixel of an image, 0 without any, [H, W].

    Args:
        shape: of the image.
        x: column of each square's centre, at most its radius outside of the image, [N].
        y: row, [N].
        radius: the squares have 2 radius + 1 pixels a side, [N].
        value: at least 0, [N].
    """
    order = np.argsort(-radius, kind="stable")
    x, y, radius, value = x[order], y[order], radius[order], value[order]
    first = np.flatnonzero(np.diff(radius, prepend=-1))  # of each radius
    radii = radius[first].tolist()
    pad = radii[0] if radii else 0
    largest: Array = np.zeros((shape[0] + 2 * pad, shape[1] + 2 * pad), np.float32)
    # From the largest to the smallest: a square grows step by step together with all that are smaller than it.
    for r, smaller, rows in zip(radii, [*radii[1:], 0], np.split(np.arange(len(order)), first[1:]), strict=False):
        np.maximum.at(largest, (y[rows] + r, x[rows] + r), value[rows])
        step = r - smaller
        grown = np.asarray(cv2.dilate(largest, np.ones((2 * step + 1, 2 * step + 1), np.uint8)), np.float32)
        largest = grown[step : len(grown) - step, step : grown.shape[1] - step].copy()
    return largest
