# SPDX-License-Identifier: GPL-3.0-or-later
"""Locate the left, right and upper edges of openings in the photos, since a mesh is blurred there by several pixels.

The photos are sampled in strips on the plane of the wall, across each edge. What lies on the wall has its gradient at
one place in all photos, while reveal and frame behind it move with the camera. The mean gradient therefore falls off
sharply on the wall's side of the edge only; the edge is put there, at upper edges further away, for the mesh slopes
more gently under lintels. Lower edges stay where the mesh has them: photos see sills from above, so what stands out
most is a sill's other edge.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from mgf_engine.model.scene import View
from mgf_engine.openings.wall_frame import WallFrame
from mgf_engine.options.algorithms import parameter

Array = NDArray[np.float64]
LEFT, TOP, RIGHT = _SIDES = (0, 1, 2)
STEP = 0.25  # of the samples across an edge, ground px
_EVERY = 7  # of these samples one is asked for whether a photo shows it
ALONG = 0.5  # of the rows of samples along it, ground px
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
        views: their cameras, normalised frame.
        photo: place among ``views`` -> RGB uint8 [H, W, 3].
        shows: place, points of the normalised frame [n, 3] and unit normal [3] -> which of them it shows, [n]. Asked
            for one view after the other.
    """

    views: Sequence[View]
    photo: Callable[[int], NDArray[np.uint8]]
    shows: Callable[[int, Array, Array], NDArray[np.bool_]]


def move_edges(
    boxes: Array,
    walls: Sequence[int],
    frames: Mapping[int, WallFrame],
    pixel: float,
    photos: EdgePhotos,
    options: OpeningEdgeOptions = OpeningEdgeOptions(),
    rises: Array | None = None,
) -> Array:
    """Move left, right and upper edges of openings to where the photos have them; those on one line together.

    Args:
        boxes: left, top, right, bottom in coordinates of their walls, [n, 4].
        walls: number of the wall that each opening is in.
        frames: number of a wall -> its coordinates.
        pixel: a ground pixel in these coordinates.
        photos: to look at.
        options: limits.
        rises: of arched heads, up to which the sides are straight, [n]; None without any.

    Returns:
        [n, 4].
    """
    offsets = np.arange(-options.reach, options.reach + 0.5 * STEP, STEP)
    straight = boxes.copy()
    straight[:, TOP] -= 0.0 if rises is None else rises
    strips = [
        _strip(box if side == TOP else below, side, frames[wall], pixel * offsets, options)
        for box, below, wall in zip(boxes, straight, walls, strict=True)
        for side in _SIDES
    ]
    curves = mean_gradients(strips, photos, options).reshape(len(boxes), len(_SIDES), len(offsets))
    result = boxes.copy()
    for side in _SIDES:
        lines: dict[tuple[int, float], list[int]] = {}
        for row, wall in enumerate(walls):
            lines.setdefault((wall, float(boxes[row, side])), []).append(row)
        for rows in lines.values():
            known = curves[rows, side][np.isfinite(curves[rows, side, 0])]
            if len(known):
                out = wall_side_edge(known.mean(0), offsets, options, above=side == TOP)
                result[rows, side] += (-1.0 if side == LEFT else 1.0) * out * pixel
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


class EdgeStrip(NamedTuple):
    """Points on a wall across an edge.

    Attributes:
        frame: of the wall.
        points: normalised frame, [rows along the edge, offsets, 3].
        outward: direction in which the offsets grow, in coordinates of the wall, [2]; out of an opening.
    """

    frame: WallFrame
    points: Array
    outward: Array


class MeanGradientOptions(Protocol):
    """What mean gradients are taken by."""

    @property
    def blur(self) -> float:
        """Standard deviation of the filter along a strip, ground pixels."""

    @property
    def shown(self) -> float:
        """Least share of a strip that a photo shows."""

    @property
    def inner(self) -> float:
        """Weight of a photo from whose place one looks at what is beyond the edge; 1 for the others."""


def mean_gradients(strips: Sequence[EdgeStrip], photos: EdgePhotos, options: MeanGradientOptions) -> Array:
    """Return the mean over the photos of the gradient across each edge, each with 1 as its largest, [n, offsets]; NaN
    where no photo shows the edge.

    Args:
        strips: across the edges, all with the same offsets.
        photos: to look at.
        options: blur, and which photos count.
    """
    return compare_gradients([[strip] for strip in strips], photos, options)[:, 0]


def compare_gradients(curves: Sequence[Sequence[EdgeStrip]], photos: EdgePhotos, options: MeanGradientOptions) -> Array:
    """Return the mean over the photos of the gradients across the curves that an edge may be, [n, curves, offsets];
    in each photo the largest across all curves of an edge is 1. NaN where no photo shows all of them.

    Args:
        curves: of each edge the strips across them, as many for each, all with the same offsets.
        photos: to look at.
        options: blur, and which photos count.
    """
    number, count = (len(curves[0]), curves[0][0].points.shape[1]) if curves else (1, 0)
    total, weights = np.zeros((len(curves), number, count)), np.zeros((len(curves), 1, 1))
    middle = np.array([some[0].points.mean((0, 1)) for some in curves]).reshape(-1, 3)
    normal = np.array([some[0].frame.normal for some in curves]).reshape(-1, 3)
    for k, view in enumerate(photos.views):
        inside = view.project_into_frame(middle, 0)[2] & (((view.centre - middle) * normal).sum(1) > 0)
        for row in np.flatnonzero(inside).tolist():
            found = [_gradient(strip, k, photos, options) for strip in curves[row]]
            shown = [one for one in found if one is not None]
            if len(shown) == number:
                gradient, weight = np.array([one[0] for one in shown]), shown[0][1]
                total[row] += gradient / (gradient.max() + _NOISE) * weight
                weights[row] += weight
    return np.divide(total, weights, out=np.full_like(total, np.nan), where=weights > 0)


def _gradient(strip: EdgeStrip, k: int, photos: EdgePhotos, options: MeanGradientOptions) -> tuple[Array, float] | None:
    """Return the gradient across an edge in a photo, grey values per ground pixel, [offsets], and the weight of the
    photo; None where it does not show the edge."""
    view, some = photos.views[k], strip.points[:, ::_EVERY]
    rows = photos.shows(k, some.reshape(-1, 3), strip.frame.normal).reshape(some.shape[:2]).mean(1) > 0.9
    if rows.mean() < options.shown:
        return None
    flat = strip.points[rows].reshape(-1, 3)
    ray = view.centre - some.mean((0, 1))
    toward = strip.frame.axes @ ray / np.linalg.norm(strip.frame.axes, axis=1)
    away = float(strip.outward @ toward[:2]) > _FACING_AWAY * toward[2]
    uv, depth = view.project(flat)
    pixels = (uv.reshape(-1, strip.points.shape[1], 2) - 0.5).astype(np.float32)
    colors = cv2.remap(photos.photo(k), pixels[..., 0], pixels[..., 1], cv2.INTER_LINEAR).astype(np.float64)
    smooth = gaussian_filter1d(colors.mean(0), options.blur / STEP, axis=0)
    gradient = np.linalg.norm(np.gradient(smooth, axis=0), axis=1) / STEP
    size = float(np.sqrt(max(toward[2], 0.0) / np.linalg.norm(ray)) * view.fx / depth.mean())
    return gradient, size * (1.0 if away else options.inner)


def _strip(box: Array, side: int, frame: WallFrame, offsets: Array, options: OpeningEdgeOptions) -> EdgeStrip:
    """Return the strip across an edge of an opening (left, top, right, bottom in coordinates of the wall, [4])."""
    left, top, right, bottom = box
    step = ALONG / STEP * float(offsets[1] - offsets[0])
    if side == TOP:
        x, y = np.meshgrid(_inner(left, right, step, options.margin), top + offsets, indexing="ij")
        outward = np.array([0.0, 1.0])
    else:
        sign = 1.0 if side == RIGHT else -1.0
        along = _inner(bottom, top, step, options.margin)
        y, x = np.meshgrid(along, (right if side == RIGHT else left) + sign * offsets, indexing="ij")
        outward = np.array([sign, 0.0])
    points = frame.points(np.stack([x, y], -1).reshape(-1, 2)).reshape(*x.shape, 3)
    return EdgeStrip(frame, points, outward)


def _inner(begin: float, end: float, step: float, margin: float) -> Array:
    """Return places along an edge, without its ends."""
    cut = margin * (end - begin)
    return np.linspace(begin + cut, end - cut, max(2, round((end - begin - 2 * cut) / step)))
