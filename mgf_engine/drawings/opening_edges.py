# SPDX-License-Identifier: GPL-3.0-or-later
"""Locate the left, right and upper edges of openings in the photos, since the mesh is blurred there by several pixels.

The photos are sampled in strips on the plane of the wall, across each edge. What lies on the wall has its gradient at
one place in all photos, while reveal and frame behind it move with the camera. The mean gradient therefore falls off
sharply on the wall's side of the edge only; the edge is put there, at upper edges further away, for the mesh slopes
more gently under lintels. Lower edges stay where the mesh has them: photos see sills from above, so what stands out
most is a sill's other edge.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from mgf_engine.drawings.model import Array, Survey
from mgf_engine.drawings.orthophoto import Visibility
from mgf_engine.drawings.regions import RegionMap
from mgf_engine.model.scene import View
from mgf_engine.options.algorithms import parameter
from mgf_engine.texture.painting import Painting

LEFT, TOP, RIGHT = 0, 1, 2
_STEP = 0.25  # of the samples across an edge, ground px
_ALONG = 0.5  # of the rows of samples along it, ground px
_FACING_AWAY = -0.05  # tangent from which a camera counts as on the wall's side of the edge
_NOISE = 3.0  # grey values per pixel added to the largest gradient of a photo, which is set to 1


@dataclass(frozen=True)
class OpeningEdgeOptions:
    """Options of the edges of openings that are taken from the photos."""

    reach: float = parameter(7.0, "Distance from the mesh's edge within which gradients are looked at", "ground px")
    blur: float = parameter(0.4, "Standard deviation of the filter along a strip", "ground px")
    margin: float = parameter(0.12, "Share of an edge left out at each of its ends", high=0.45)
    shown: float = parameter(0.5, "Minimum share of a strip that a photo shows", high=1)
    inner: float = parameter(0.15, "Weight of a photo that looks at the reveal; 1 for one that does not", high=1)
    outward: tuple[float, float] = parameter(
        (0.25, 0.0), "Expected distance of the edge from the mesh's, away from the opening; at the sides, and above",
        "ground px", low=None,
    )  # fmt: skip
    spread: tuple[float, float] = parameter(
        (1.5, 2.0), "Standard deviation of that distance, at the sides and above", "ground px", low=0.01
    )
    farthest: tuple[float, float] = parameter(
        (3.0, 4.0), "Maximum distance of the edge from the mesh's, at the sides and above", "ground px"
    )
    prominence: float = parameter(0.2, "Minimum drop of the mean gradient on the wall's side, as a share", high=1)
    flank: float = parameter(0.6, "Distance of the half of the drop from an edge, by the blur of photos", "ground px")


@dataclass(frozen=True)
class EdgePhotos:
    """The photos that edges are looked for in.

    Attributes:
        views: their cameras.
        photo: place among ``views`` -> RGB uint8 [H, W, 3].
        shows: place, points of the normalised frame and normals [n, 3] -> which of them it shows, [n].
        normalise: local frame -> normalised frame, [n, 3].
        turn_normal: normal in the local frame -> in the normalised frame, [3].
    """

    views: Sequence[View]
    photo: Callable[[int], NDArray[np.uint8]]
    shows: Callable[[int, Array, Array], NDArray[np.bool_]]
    normalise: Callable[[Array], Array]
    turn_normal: Callable[[Array], Array]


def edge_photos(survey: Survey, painting: Painting, visibility: Visibility) -> EdgePhotos:
    """Return the photos that paint a survey's orthophotos, at their working size."""
    return EdgePhotos(
        painting.views,
        lambda k: survey.scene.photo(painting.chosen[k]),
        lambda k, points, normals: visibility(k, points, normals)[0] > 0,
        survey.normalise,
        survey.turn_to_normalised,
    )


def move_edges(
    boxes: Array,
    walls: Sequence[int],
    regions: RegionMap,
    pixel: float,
    photos: EdgePhotos,
    options: OpeningEdgeOptions = OpeningEdgeOptions(),
) -> Array:
    """Move left, right and upper edges of openings to where the photos have them; those on one line together.

    Args:
        boxes: left, top, right, bottom in pixels of the map, [n, 4].
        walls: label of the wall that each opening is in.
        regions: of the elevation, with their planes.
        pixel: a ground pixel, local unit.
        photos: to look at.
        options: limits.

    Returns:
        [n, 4].
    """
    result, offsets = boxes.copy(), np.arange(-options.reach, options.reach + 0.5 * _STEP, _STEP)
    for side in (LEFT, TOP, RIGHT):
        lines: dict[tuple[int, float], list[int]] = {}
        for row, wall in enumerate(walls):
            lines.setdefault((wall, float(boxes[row, side])), []).append(row)
        for (wall, _), rows in lines.items():
            found = [_mean_gradient(boxes[row], side, wall, regions, pixel * offsets, photos, options) for row in rows]
            curves = [curve for curve in found if curve is not None]
            if not curves:
                continue
            out = wall_side_edge(np.mean(curves, axis=0), offsets, options, above=side == TOP)
            sign = 1.0 if side == RIGHT else -1.0
            result[rows, side] += sign * out * pixel / regions.grid.resolution
    return result


def wall_side_edge(
    gradient: Array, offsets: Array, options: OpeningEdgeOptions = OpeningEdgeOptions(), above: bool = False
) -> float:
    """Find the offset of an edge in a mean gradient [n]; 0, the mesh's edge, if it shows none.

    Of the maxima that fall off towards the wall, the one is chosen whose height, times a normal distribution around
    the expected place, is largest. The edge lies where it has fallen to a half, less the blur of the photos.

    Args:
        gradient: at ``offsets``.
        offsets: distances from the mesh's edge, away from the opening, evenly spaced [n].
        options: expected place, prominence and blur.
        above: the edge is an upper one.
    """
    outward, spread, farthest = (pair[above] for pair in (options.outward, options.spread, options.farthest))
    best, place = 0.0, 0.0
    for k in range(2, len(gradient) - 2):
        if not gradient[k - 1] <= gradient[k] > gradient[k + 1]:
            continue
        end = k
        while end < len(gradient) - 1 and gradient[end + 1] < gradient[end]:
            end += 1
        if gradient[end] > (1 - options.prominence) * gradient[k]:
            continue
        below = np.flatnonzero(gradient[k : end + 1] <= 0.5 * gradient[k])
        at = float(offsets[end])
        if len(below):
            j = k + int(below[0])
            share = (gradient[j - 1] - 0.5 * gradient[k]) / (gradient[j - 1] - gradient[j])
            at = float(offsets[j - 1] + share * (offsets[j] - offsets[j - 1]))
        at -= options.flank
        if abs(at) > farthest:
            continue
        likely = float(gradient[k] * np.exp(-0.5 * ((at - outward) / spread) ** 2))
        if likely > best:
            best, place = likely, at
    return place


def _mean_gradient(
    box: Array,
    side: int,
    wall: int,
    regions: RegionMap,
    offsets: Array,
    photos: EdgePhotos,
    options: OpeningEdgeOptions,
) -> Array | None:
    """Return the mean over the photos of the gradient across an edge, each with 1 as its largest, [n]; None where no
    photo shows the edge."""
    at, outward = _strip(box, side, regions, offsets, options)
    frame = regions.grid.frame
    local = frame.to_local(np.column_stack([at.reshape(-1, 2), regions.before(wall, at.reshape(-1, 2))]))
    points = photos.normalise(local)
    axes = photos.normalise(local.mean(0) + np.stack([np.zeros(3), *np.stack([frame.x, frame.y, frame.normal])]))
    axes = axes[1:] - axes[0]
    normals = np.broadcast_to(photos.turn_normal(frame.normal), points.shape)
    total, weights = np.zeros(len(offsets)), 0.0
    for k, view in enumerate(photos.views):
        rows = photos.shows(k, points, normals).reshape(at.shape[:2]).mean(1) > 0.9
        if rows.mean() < options.shown:
            continue
        ray = view.centre - points.mean(0)
        toward = axes @ ray
        away = float(outward @ toward[:2]) > _FACING_AWAY * toward[2]
        uv, depth = view.project(points)
        pixels = (uv.reshape(*at.shape[:2], 2)[rows] - 0.5).astype(np.float32)
        strip = cv2.remap(photos.photo(k), pixels[..., 0], pixels[..., 1], cv2.INTER_LINEAR).astype(np.float64)
        smooth = gaussian_filter1d(strip.mean(0), options.blur / _STEP, axis=0)
        gradient = np.linalg.norm(np.gradient(smooth, axis=0), axis=1) / _STEP
        size = np.sqrt(toward[2] / np.linalg.norm(ray)) * view.fx / float(np.median(depth))
        weight = size * (1.0 if away else options.inner)
        total += weight * gradient / (gradient.max() + _NOISE)
        weights += weight
    return total / weights if weights > 0 else None


def _strip(
    box: Array, side: int, regions: RegionMap, offsets: Array, options: OpeningEdgeOptions
) -> tuple[Array, Array]:
    """Return points across an edge in drawing coordinates, [rows along it, offsets, 2], and the direction out of the
    opening [2]."""
    left, top = regions.grid.places(box[:2])
    right, bottom = regions.grid.places(box[2:])
    step = _ALONG / _STEP * float(offsets[1] - offsets[0])
    sign = 1.0 if side == RIGHT else -1.0
    if side == TOP:
        x, y = np.meshgrid(_inner(left, right, step, options.margin), top + offsets, indexing="ij")
        return np.stack([x, y], -1), np.array([0.0, 1.0])
    along = _inner(bottom, top, step, options.margin)
    y, x = np.meshgrid(along, (right if side == RIGHT else left) + sign * offsets, indexing="ij")
    return np.stack([x, y], -1), np.array([sign, 0.0])


def _inner(begin: float, end: float, step: float, margin: float) -> Array:
    """Return places along an edge, without its ends."""
    cut = margin * (end - begin)
    return np.linspace(begin + cut, end - cut, max(2, round((end - begin - 2 * cut) / step)))
