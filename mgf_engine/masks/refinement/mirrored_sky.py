# SPDX-License-Identifier: GPL-3.0-or-later
"""Separate sky seen through the building from sky mirrored in its panes.

Behind a real opening, some point on the ray is outside the silhouettes of photos that look through the same opening.
The ray of a mirror image passes through the closed building, which is inside all other silhouettes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.boxes import percentile_box
from mgf_engine.model.masks import IGNORE, building
from mgf_engine.model.scene import Scene, View
from mgf_engine.options.algorithms import parameter

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MirroredSkyOptions:
    """Options of sky that is mirrored."""

    held: float = parameter(
        0.97,
        "Share of the other photos whose masks contain the best sample of a hole, from which it is a mirror image",
        low=0.01,
        high=1,
    )
    samples: int = parameter(48, "Number of samples along a ray", low=2)
    step: int = parameter(3, "Distance between rows of rays", "px", low=1)
    least_views: int = parameter(3, "Minimum number of other photos that have a sample in their frame", low=1)
    percentiles: tuple[float, float] = parameter(
        (0.5, 99.5), "Percentiles of the building's sparse points that bound the box of the samples", high=100
    )
    padding: float = parameter(0.03, "Space around them, as a share of the longest side")


def find_mirrored_sky(
    scene: Scene,
    index: int,
    holes: NDArray[np.bool_],
    labels: Sequence[NDArray[np.uint8]],
    views: Sequence[int],
    points: Array,
    options: MirroredSkyOptions = MirroredSkyOptions(),
) -> NDArray[np.bool_]:
    """Find the holes that are mirror images: by half of their rays or more, bool [H, W].

    Args:
        scene: photos and cameras, normalised frame.
        index: of the view.
        holes: sky found inside its mask, bool [H, W].
        labels: label maps of all photos [H, W], with holes cut out.
        views: those whose masks are asked.
        points: sparse points of the building, [N, 3]; where there are none, nothing is a mirror image.
        options: rays, and how many photos must hold their places.
    """
    height, width = holes.shape
    if not len(points) or not holes.any():
        return np.zeros_like(holes)
    count, pieces = cv2.connectedComponents(holes.astype(np.uint8), connectivity=4)
    grid = (np.arange(height)[:, None] + np.arange(width)) % options.step == 0  # every row and column has rays
    y, x = np.nonzero(holes & grid)
    box = percentile_box(points, options.percentiles, options.padding)
    places = _along_rays(scene.views[index], np.stack([x, y], 1).astype(np.float64) + 0.5, box, options.samples)
    share = _held_share(scene, labels, [i for i in views if i != index], places.reshape(-1, 3), options)
    best = share.reshape(places.shape[:2]).max(1)
    rays = np.bincount(pieces[y, x], minlength=count)
    held = np.bincount(pieces[y, x], best >= options.held, minlength=count)
    closed = (rays > 0) & (2 * held >= rays)
    return np.asarray(holes & closed[pieces], bool)


def _along_rays(view: View, uv: Array, box: tuple[Array, Array], samples: int) -> Array:
    """Return places within the box along the rays of pixels [N, 2], [N, samples, 3]; NaN for rays that miss it."""
    ray = view.unproject(uv, np.ones(len(uv))) - view.centre
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack([(corner - view.centre) / ray for corner in box])
    enter, leave = np.maximum(ends.min(0).max(1), 0.0), ends.max(0).min(1)
    enter[~(leave > enter)] = np.nan
    at = enter[:, None] + (leave - enter)[:, None] * ((np.arange(samples) + 0.5) / samples)
    return np.asarray(view.centre + at[..., None] * ray[:, None], np.float64)


def _held_share(
    scene: Scene, labels: Sequence[NDArray[np.uint8]], views: Sequence[int], places: Array, options: MirroredSkyOptions
) -> Array:
    """Return the share of the photos that show places [N, 3] on the building, 0 where too few show them at all, [N]."""
    held, shown = np.zeros((2, len(places)))
    for other in views:
        view = scene.views[other]
        uv, _, framed = view.project_into_frame(places)
        x, y = uv[framed].astype(np.int64).T
        label = labels[other][y, x]
        held[framed] += building(label)
        shown[framed] += label != IGNORE
    return np.where(shown >= options.least_views, held / np.maximum(shown, 1), 0.0)
