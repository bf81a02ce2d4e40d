# SPDX-License-Identifier: GPL-3.0-or-later
"""Photometric refinement of depth maps: search along each ray for the depth with the best patch correlation.

Depths rendered from the field are accurate to about half a pixel. Patch matching between two photos is accurate to a
tenth of a pixel, but needs texture and a good initial depth, which the rendering provides. Where nothing correlates,
the rendered depth is kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mgf_engine.model.scene import View
from mgf_engine.native.library import parallel
from mgf_engine.options.algorithms import parameter
from mgf_engine.scene.kernel_photos import pack_quads, photo_struct

PATCH_PIXELS = 25  # pixels of a patch; their depths have the same error

Array = NDArray[np.float32]


@dataclass(frozen=True)
class MatchOptions:
    """Options of photometric depth refinement: how far and how finely depths are tried, and which matches count."""

    steps: int = parameter(9, "Number of depths that are tried at each pixel; odd", low=3, high=99)
    pixels: float = parameter(
        0.5, "Parallax between two tried depths, in the neighbour that sees the most of it", "px", low=1e-3
    )
    jump: float = parameter(0.01, "Maximum distance of a patch's pixels from its plane, as a share of the depth")
    hidden: float = parameter(0.02, "Maximum difference from the neighbour's own depth, as a share of the depth")
    texture: float = parameter(0.008 * 255, "Minimum standard deviation of a patch's brightness", "grey levels")
    least_noise: float = parameter(
        0.02, "Minimum share of a patch's variance that no other photo explains", low=1e-6, high=1
    )
    least_correlation: float = parameter(0.6, "Minimum correlation at the best depth", high=1)


@dataclass(frozen=True)
class RenderedSurface:
    """A photo with the depth and normals rendered from its view.

    Attributes:
        view: the camera.
        grey: the photo in grey levels, uint8 [H, W].
        depth: float32 [H, W], 0 for no surface.
        normal: unit normals in the camera frame, facing the camera, float32 [H, W, 3].
        free_space: pixels that see past every surface, bool [H, W].
    """

    view: View
    grey: NDArray[np.uint8]
    depth: Array
    normal: Array
    free_space: NDArray[np.bool_]

    @cached_property
    def quads(self) -> NDArray[np.uint32]:
        """The photo with each pixel's 2 x 2 neighbourhood packed into one number, as the kernels read it, [H, W]."""
        return pack_quads(self.grey)


@dataclass(frozen=True)
class Matched:
    """A depth map after matching with the neighbouring photos; all arrays float32 [H, W].

    Attributes:
        depth: 0 for no surface.
        correlation: mean normalised cross-correlation at that depth, 0..1; 0 without a match.
        precision: inverse variance of the depth, per square pixel of parallax; 0 without a match.
        parallax: relative change of the inverse depth per pixel of parallax; 0 without a match.
        unmatched_weight: weight of depths without a match; None takes the option ``tsdf.unmatched``.
    """

    depth: Array
    correlation: Array
    precision: Array
    parallax: Array
    unmatched_weight: Array | None = None


def without_match(surface: RenderedSurface) -> Matched:
    """Return the rendered depth as an unmatched one."""
    nothing = np.zeros_like(surface.depth)
    return Matched(surface.depth, nothing, nothing, nothing)


def match_surface(
    first: RenderedSurface, others: Sequence[RenderedSurface], options: MatchOptions = MatchOptions()
) -> Matched:
    """Refine the depth of ``first`` to the best mean correlation with its neighbours among the depths tried."""
    pixels = np.flatnonzero(first.depth.ravel() > 0).astype(np.int32)
    correlation, precision, parallax = (np.zeros(first.depth.size, np.float32) for _ in range(3))
    depth = first.depth.ravel().copy()
    if len(pixels) and others:
        scores, counts, step = correlations(first, others, pixels, options)
        shift, best, curvature = _peak(scores, counts, options.least_correlation)
        depth[pixels] = depth[pixels] / (1 + shift * step)
        correlation[pixels], parallax[pixels] = best, step / options.pixels
        noise = np.maximum(1 - best, options.least_noise) * PATCH_PIXELS * options.pixels**2
        precision[pixels] = counts * curvature / noise
    return Matched(*(values.reshape(first.depth.shape) for values in (depth, correlation, precision, parallax)))


def correlations(
    first: RenderedSurface,
    others: Sequence[RenderedSurface],
    pixels: NDArray[np.int32],
    options: MatchOptions = MatchOptions(),
) -> tuple[Array, Array, Array]:
    """Compute the normalised cross-correlation of patches at each tried depth, summed over the neighbours.

    The tried depths are ``depth / (1 + (k - steps // 2) * step)``; pixels closer than two to the frame are left out.

    Args:
        first: photo and depth map that is refined.
        others: photos and depth maps of the neighbours.
        pixels: flat indices of the pixels, int32 [N].
        options: number and length of the steps, and the occlusion test.

    Returns:
        Sums of correlations [N, steps], number of neighbours that see the pixel [N], and the steps [N].
    """
    count, view = len(pixels), first.view
    scores, counts, step = (np.zeros(shape, np.float32) for shape in ((count, options.steps), count, count))
    normals = np.ascontiguousarray(first.normal.reshape(-1, 3)[pixels])
    inverse = np.array([1 / view.fx, 1 / view.fy, view.cx, view.cy], np.float32)
    parallel(
        "mgf_match_photos", count, pixels, normals, options.pixels, options.steps, _struct([first], view), inverse,
        _struct(others, view), len(others), options.jump, options.hidden, options.texture, step, scores, counts,
    )  # fmt: skip
    return scores, counts, step


def _struct(surfaces: Sequence[RenderedSurface], first: View) -> NDArray[np.void]:
    return photo_struct(first, [(s.quads, s.depth, s.view) for s in surfaces])


def _peak(scores: Array, counts: Array, least: float) -> tuple[Array, Array, Array]:
    """Find the peak of the mean correlation by a parabola: offset in steps, value and curvature, [N] each.

    All are 0 where there is no peak of at least ``least``.
    """
    count, steps = scores.shape
    best = np.clip(scores.argmax(1), 1, steps - 2)
    at, mean = np.arange(0, count * steps, steps) + best, np.maximum(counts, 1)
    low, top, high = (scores.ravel().take(at + k) / mean for k in (-1, 0, 1))
    curvature = low - 2 * top + high
    sure = (counts > 0) & (top >= least) & (top >= low) & (top >= high) & (curvature < 0)
    offset = 0.5 * (low - high) / np.where(sure, curvature, 1.0)
    shift = best - steps // 2 + offset
    values = (shift, top, -curvature)
    shift, top, sharp = (np.where(sure, value, 0).astype(np.float32) for value in values)
    return shift, top, sharp
