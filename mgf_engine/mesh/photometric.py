# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth maps moved along their rays to where neighbouring photos look most alike.

The field is trained on colours, one photo at a time, and knows a surface to about half a pixel. Patches of two photos
that see the same spot tell its depth to a tenth of one, but only near the truth and only where there is texture: the
rendered depth gives them the start, and keeps the last word where they say nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.raster.library import parallel
from mgf_engine.scene.model import View

JUMP = 0.01  # share of the depth that pixels of one surface may differ from its plane
HIDDEN = 0.02  # share of the depth that the neighbour's own depth may differ
TEXTURE = 0.008  # least standard deviation of a patch's brightness
SURE = 0.6  # least correlation at the best depth

Array = NDArray[np.float32]
Progress = Callable[[float], None]


@dataclass(frozen=True)
class Search:
    """Which depths are tried: ``steps`` of them (odd), each of which moves a pixel by ``pixels`` in the neighbour that
    sees the most parallax."""

    steps: int
    pixels: float


WIDE = Search(9, 0.5)


@dataclass(frozen=True)
class Surface:
    """A photo and what the field shows in it.

    Attributes:
        grey: float32 [H, W], brightness 0..1.
        depth: float32 [H, W], 0 where no surface is shown.
        normal: float32 [H, W, 3], unit, in the camera's frame, facing the camera.
        through: bool [H, W], where the view looks past everything.
    """

    view: View
    grey: Array
    depth: Array
    normal: Array
    through: NDArray[np.bool_]


@dataclass(frozen=True)
class Matched:
    """What the neighbours make of a depth map: [H, W] depth, and 0..1 how alike the photos look there (0: no say)."""

    depth: Array
    likeness: Array


def unmatched(surface: Surface) -> Matched:
    """The depth as rendered."""
    return Matched(surface.depth, np.zeros_like(surface.depth))


def match_surface(first: Surface, others: Sequence[Surface], search: Search = WIDE) -> Matched:
    """The depth of ``first`` where its photo and the neighbours' agree best among those searched."""
    pixels = np.flatnonzero(first.depth.ravel() > 0).astype(np.int32)
    likeness = np.zeros(first.depth.size, np.float32)
    depth = first.depth.ravel().copy()
    if len(pixels) and others:
        step = _step(first, others, pixels, search)
        scores, counts = correlations(first, others, pixels, step, search.steps)
        shift, best = _peak(scores, counts)
        depth[pixels] = depth[pixels] / (1 + shift * step)
        likeness[pixels] = best
    shape = first.depth.shape
    return Matched(depth.reshape(shape), likeness.reshape(shape))


def correlations(
    first: Surface, others: Sequence[Surface], pixels: NDArray[np.int32], step: Array, steps: int = WIDE.steps
) -> tuple[Array, Array]:
    """Correlation of the patches around ``pixels`` [N] for each tried depth, summed over neighbours that see them.

    The tried depths are ``depth / (1 + (k - steps // 2) * step)``.

    Returns:
        sums [N, steps] and number of neighbours [N].
    """
    scores, counts = np.zeros((len(pixels), steps), np.float32), np.zeros(len(pixels), np.float32)
    normals = np.ascontiguousarray(first.normal.reshape(-1, 3)[pixels])
    view = first.view
    inverse = np.array([1 / view.fx, 1 / view.fy, view.cx, view.cy], np.float32)
    for other in others:
        parallel(
            "match_depths_work", len(pixels), pixels, normals, step, steps, first.grey, first.depth, *first.depth.shape,
            inverse, between(view, other.view), other.grey, other.depth, *other.depth.shape,
            JUMP, HIDDEN, TEXTURE, scores, counts,
        )  # fmt: skip
    return scores, counts


def between(first: View, second: View) -> NDArray[np.float64]:
    """M [3, 3] and b [3], flat [12]: a pixel (x, y) at a depth lies in the second photo at M (x, y, 1) + b / depth."""
    rotation = second.rotation @ first.rotation.T
    translation = second.translation - rotation @ first.translation
    to_second = _intrinsics(second)
    return np.concatenate([(to_second @ rotation @ np.linalg.inv(_intrinsics(first))).ravel(), to_second @ translation])


def _intrinsics(view: View) -> NDArray[np.float64]:
    return np.array([[view.fx, 0, view.cx], [0, view.fy, view.cy], [0, 0, 1]])


def _step(first: Surface, others: Sequence[Surface], pixels: NDArray[np.int32], search: Search) -> Array:
    """Relative change of the inverse depth that moves a pixel by one step where it moves the most, [N]."""
    width = first.depth.shape[1]
    inverse = 1.0 / first.depth.ravel()[pixels].astype(np.float64)
    rays = np.stack([pixels % width + 0.5, pixels // width + 0.5, np.ones(len(pixels))], 1)
    most = np.full(len(pixels), 1e-6)
    for other in others:
        m = between(first.view, other.view)
        at = [rays @ m[:9].reshape(3, 3).T + m[9:] * (inverse * factor)[:, None] for factor in (1.0, 1.001)]
        ahead = (at[0][:, 2] > 0) & (at[1][:, 2] > 0)
        uv = [a[:, :2] / np.where(ahead, a[:, 2], 1.0)[:, None] for a in at]
        moved = np.linalg.norm(uv[1] - uv[0], axis=1) / 0.001
        most = np.where(ahead, np.maximum(most, moved), most)
    return np.minimum(search.pixels / most, 0.5 / search.steps).astype(np.float32)


def _peak(scores: Array, counts: Array) -> tuple[Array, Array]:
    """Where the mean correlation peaks, in steps from the start, and how high, [N] each; 0, 0 where nothing is sure."""
    rows = np.arange(len(scores))
    best = np.clip(scores.argmax(1), 1, scores.shape[1] - 2)
    mean = np.maximum(counts, 1)
    low, top, high = (scores[rows, best + k] / mean for k in (-1, 0, 1))
    curvature = low - 2 * top + high
    sure = (counts > 0) & (top >= SURE) & (top >= low) & (top >= high) & (curvature < 0)
    offset = 0.5 * (low - high) / np.where(sure, curvature, 1.0)
    shift = best - scores.shape[1] // 2 + offset
    return np.where(sure, shift, 0).astype(np.float32), np.where(sure, top, 0).astype(np.float32)
