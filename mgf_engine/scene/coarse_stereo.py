# SPDX-License-Identifier: GPL-3.0-or-later
"""Match reduced photos where fine textures alias (moiré).

Where a texture is finer than the pixels, each photo samples another pattern of it: contrast is high, and no two photos
agree. Reduced photos show what the pattern hides: edges, shadows and colours of whole surfaces. Patches of many photos
are compared, since the remains of the pattern differ from photo to photo.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.options.algorithms import parameter
from mgf_engine.scene.depths import Depths, Matching, match_photos
from mgf_engine.scene.neighbours import MatchingPoints
from mgf_engine.scene.patch_match import PatchMatchOptions, improve_depths


@dataclass(frozen=True)
class CoarseStereoOptions:
    """When photos are reduced before they are matched, and how they are matched then."""

    texture: float = parameter(
        0.6, "Minimum gradient of brightness (0 to 100) per px in its weakest direction within 7 x 7 px"
    )
    least_confirmed: float = parameter(
        0.2, "Share of the textured pixels about which two photos agree below which photos are reduced", high=1
    )
    neighbourhood: int = parameter(9, "Side of the square around a click in which its texture is measured", "px", low=1)
    textured: float = parameter(0.5, "Minimum share of textured pixels around a click", high=1)
    confirmed: float = parameter(
        0.3,
        "Share of the pixels around a click where two photos agree, from which reduced photos are not needed",
        high=1,
    )
    least_clicks: float = parameter(
        0.75, "Share of the clicks on texture without agreement from which reduced photos are matched for the masks",
        low=0.01, high=1,
    )  # fmt: skip
    most_clicks: float = parameter(
        0.4, "Share of the clicks without agreement in reduced photos, too, above which these are not used (mirrors)",
        high=1,
    )  # fmt: skip
    longest_side: int = parameter(750, "Longest side of a photo before it is reduced", "px", low=48)
    factor: float = parameter(3.0, "Factor by which photos are reduced", low=1)
    blur: float = parameter(1.0, "Standard deviation by which reduced photos are blurred", "px")
    window: int = parameter(4, "Half width of the window of semi-global matching", "px", low=0, high=10)
    neighbours: int = parameter(8, "Number of photos that each photo is compared with by PatchMatch", low=1, high=8)
    best: int = parameter(
        4, "Number of compared photos, those with the highest correlation, that rate a plane", low=1, high=4
    )
    rounds: int = parameter(4, "Number of rounds of PatchMatch", low=1)
    deviation: float = parameter(0.5, "Minimum standard deviation of a patch's brightness", "grey levels")
    score: float = parameter(0.4, "Minimum correlation of a depth", high=1)


def texture_strength(light: NDArray[Any]) -> NDArray[np.float32]:
    """Compute the root mean square of the gradient within 7 x 7 px in its weakest direction, per px, [H, W].

    The smaller eigenvalue of the structure tensor (Shi and Tomasi 1994): a straight edge matches anywhere along itself,
    and lines have points of their own.
    """
    # OpenCV's tensor is of Sobel differences over a length of two pixels.
    least = np.maximum(cv2.cornerMinEigenVal(light, 7, ksize=3), 0)
    return np.asarray(np.sqrt(least) / 2, np.float32)


def _textured(depths: Depths, index: int, options: CoarseStereoOptions) -> NDArray[np.bool_]:
    """Tell which pixels of a photo have texture, bool [h, w]."""
    photo = depths.photos[index]
    return np.asarray(photo.inside & (texture_strength(photo.grey.astype(np.float32) / 2.55) > options.texture), bool)


def confirmed_texture(depths: Depths, options: CoarseStereoOptions) -> float:
    """Compute the share of the textured pixels of all depth maps that a neighbour confirms; 1 without any."""
    total = confirmed = 0
    for index in depths.maps:
        textured = _textured(depths, index, options)
        total += int(textured.sum())
        confirmed += len(depths.points(index, textured)[0])
    return confirmed / total if total else 1.0


def on_aliased_texture(
    depths: Depths, index: int, places: NDArray[np.floating], options: CoarseStereoOptions
) -> NDArray[np.bool_]:
    """Find the positions in a photo whose texture no neighbouring photo confirms, which is probably aliased.

    Args:
        depths: depth maps of the photos.
        index: the photo.
        places: x, y as shares of its sides, [N, 2].
        options: what counts as texture, and how much of it must be confirmed.

    Returns:
        bool [N].
    """
    textured = _textured(depths, index, options)
    agreed = np.zeros(textured.shape, np.float32)
    if index in depths.maps:
        agreed[tuple(depths.points(index, np.ones_like(textured))[0].T)] = 1
    around = (options.neighbourhood, options.neighbourhood)
    aliased = (cv2.blur(textured.astype(np.float32), around) > options.textured) & (
        cv2.blur(agreed, around) < options.confirmed
    )
    height, width = textured.shape
    column, row = np.clip((places * (width, height)).astype(int), 0, (width - 1, height - 1)).T
    return np.asarray(aliased[row, column], bool)


def match_reduced(
    points: MatchingPoints,
    inside: Callable[[int], NDArray[np.bool_]] | None,
    matching: Matching,
    options: CoarseStereoOptions,
    threads: int,
    check: Callable[[], None],
) -> Depths:
    """Compute the depth maps of reduced photos, as :func:`match_photos` and then by PatchMatch.

    Args:
        points: photos and cameras, and the sparse points that choose neighbours and the range of depths.
        inside: view -> bool [H, W], the pixels that are wanted; None for all.
        matching: options for photos that are not reduced.
        options: how far photos are reduced, and what counts.
        threads: number of worker threads.
        check: called between photos; may raise to cancel.
    """
    largest = max(max(view.width, view.height) for view in (points.scene.views[i] for i in points.views))
    stereo = replace(matching.stereo, window=options.window)
    reduced = replace(
        matching,
        longest_side=round(min(options.longest_side, largest) / options.factor),
        stereo=stereo,
        blur=options.blur,
    )
    depths = match_photos(points, inside, reduced, threads, check)
    search = PatchMatchOptions(
        neighbours=options.neighbours, best=options.best, rounds=options.rounds, texture=options.deviation,
        sure_score=options.score, agreed_score=min(options.score, PatchMatchOptions.agreed_score),
        unmatched_rounds=options.rounds, unmatched_share=0.0, unmatched_score=options.score,
    )  # fmt: skip
    return improve_depths(depths, points, stereo.neighbours, search, check)
