# SPDX-License-Identifier: GPL-3.0-or-later
"""Remove the far background seen through an open building: lawn up to the horizon, and the haze above it.

The masks are drawn around the bars of a frame as a whole, with the background between them. It is too far away for
other photos to confirm it as ground, and too low to be sky. But beside the building, at the same elevation angle, the
same photo (or another one) shows the same colour.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.geometry.elevation import elevation
from mgf_engine.masks.image_ops import color_distance, erode, rgb_to_lab
from mgf_engine.model.masks import BACKGROUND
from mgf_engine.model.pixels import pixel_at
from mgf_engine.model.scene import Scene, View
from mgf_engine.native.parallel import parallel_map
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class FarBackgroundOptions:
    """Options of the far background; distances of colours are in CIELAB."""

    rim: int = parameter(3, "Distance between the mask and the background that is learned from", "px")
    least_pixels: int = parameter(150, "Minimum number of background pixels at an elevation", low=1)
    spread: float = parameter(
        2.0, "Colour distance up to which a pixel is background, as a factor of the median distance"
    )
    least: float = parameter(6.0, "Minimum colour distance up to which a pixel is background", low=0.1)
    most: float = parameter(
        14.0, "Maximum colour distance up to which a pixel is background; a larger spread means several things"
    )
    usual: float = parameter(15.0, "Maximum distance of a photo's colour from the median of all photos")
    least_photos: int = parameter(3, "Minimum number of photos that know the colour of an elevation", low=1)
    alike_points: float = parameter(
        0.05, "Share of the building's sparse points with the colour beyond which it proves nothing", high=1
    )
    enough_points: int = parameter(10, "Minimum number of sparse points for that test")
    elevations: tuple[float, float] = parameter(
        (-25.0, 6.0),
        "Elevations between which colours are compared: below, other photos confirm the ground; above is sky",
        "degrees",
        low=-90,
        high=90,
    )
    step: float = parameter(0.5, "Step between the elevations", "degrees", low=0.01)

    @property
    def levels(self) -> int:
        """Number of steps between the elevations."""
        return round((self.elevations[1] - self.elevations[0]) / self.step)


@dataclass(frozen=True)
class ElevationColors:
    """Background colour by elevation angle: CIELAB [L, 3], and the colour distance up to which a pixel is alike, [L].

    A distance of 0 means unknown.
    """

    color: NDArray[np.float32]
    near: NDArray[np.float32]


def remove_far_background(
    scene: Scene,
    labels: Sequence[NDArray[np.uint8]],
    up: NDArray[np.float64],
    points_in: Callable[[int], NDArray[np.floating]],
    threads: int = 1,
    options: FarBackgroundOptions = FarBackgroundOptions(),
) -> None:
    """Set pixels that look like the far background beside the building to background, in place.

    Args:
        scene: normalised frame.
        labels: per view uint8 [H, W]; only that of an open building should be given.
        up: [3], normalised frame.
        points_in: view -> [N, 2], pixels in which it observed sparse points of the building.
        threads: photos that are worked on at a time.
        options: levels over the horizon, and how alike their colours must be.
    """

    def learn(index: int) -> ElevationColors:
        return _learn_colors(scene.photo(index), labels[index], scene.views[index], up, options)

    def cut(index: int) -> None:
        level = _level_of(scene.views[index], up, options)
        alike = _find_alike(scene.photo(index), level, levels[index])
        if not _holds_points(alike, level, points_in(index), options):
            labels[index][alike] = BACKGROUND

    views = range(len(labels))
    levels = _agree_on_colors(list(parallel_map(learn, views, threads)), options)
    for _ in parallel_map(cut, views, threads):
        pass


def _learn_colors(
    photo: NDArray[np.uint8],
    labels: NDArray[np.uint8],
    view: View,
    up: NDArray[np.float64],
    options: FarBackgroundOptions,
) -> ElevationColors:
    """Return the usual colour of each level in one photo's background."""
    level = _level_of(view, up, options)
    chosen = (level >= 0) & erode(labels == BACKGROUND, options.rim)
    order = np.argsort(level[chosen], kind="stable")
    colors = _color(photo)[chosen][order]
    cuts = np.searchsorted(level[chosen][order], np.arange(options.levels + 1))
    result = ElevationColors(np.zeros((options.levels, 3), np.float32), np.zeros(options.levels, np.float32))
    for row, (start, end) in enumerate(pairwise(cuts)):
        if end - start >= options.least_pixels:
            here = colors[start:end]
            usual = np.median(here, axis=0)
            near = options.spread * float(np.median(np.linalg.norm(here - usual, axis=1)))
            result.color[row], result.near[row] = usual, max(near, options.least)
    return result


def _agree_on_colors(found: list[ElevationColors], options: FarBackgroundOptions) -> list[ElevationColors]:
    """Return each photo's levels, less those that are too uneven or unlike all photos; of all photos where it has
    none."""
    color, near = np.stack([f.color for f in found]), np.stack([f.near for f in found])
    good = (near > 0) & (near < options.most)
    enough = good.sum(0) >= options.least_photos
    usual, spread = _median(color, good), _median(near, good)
    good &= np.linalg.norm(color - usual, axis=2) < options.usual
    result = []
    for own, known, has in zip(found, good, near > 0, strict=True):
        width = np.where(has, own.near * known, spread) * enough
        result.append(ElevationColors(np.where(has[:, None], own.color, usual), width.astype(np.float32)))
    return result


def _median(values: NDArray[np.float32], good: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Compute the median over the first axis, of the good ones, [V, K, ...] -> [K, ...]; 0 where none is."""
    masked = np.ma.masked_array(values, ~good if values.ndim == 2 else np.repeat(~good[:, :, None], 3, 2))
    return np.asarray(np.ma.median(masked, axis=0).filled(0), np.float32)


def _find_alike(photo: NDArray[np.uint8], level: NDArray[np.int16], levels: ElevationColors) -> NDArray[np.bool_]:
    """Return pixels that have the colour of their level, [H, W]."""
    away = color_distance(_color(photo), levels.color[level])
    return np.asarray((level >= 0) & (away < levels.near[level]), bool)


def _holds_points(
    alike: NDArray[np.bool_], level: NDArray[np.int16], points: NDArray[np.floating], options: FarBackgroundOptions
) -> bool:
    """Tell whether the building's own points lie in what looks like background."""
    y, x = pixel_at(alike.shape, points)
    here = erode(alike, options.rim)[y, x][level[y, x] >= 0]
    return bool(len(here) >= options.enough_points and here.mean() > options.alike_points)


def _level_of(view: View, up: NDArray[np.float64], options: FarBackgroundOptions) -> NDArray[np.int16]:
    """Return the row of each pixel's level, -1 below and above all, [H, W]."""
    level = np.floor((elevation(view, up) - options.elevations[0]) / options.step).astype(np.int16)  # sorted fast
    level[level >= options.levels] = -1
    return np.maximum(level, -1)


def _color(photo: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return CIELAB, means of 3 x 3 pixels: without the grain of a photo."""
    return np.asarray(cv2.blur(rgb_to_lab(photo), (3, 3)), np.float32)
