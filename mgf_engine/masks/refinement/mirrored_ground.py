# SPDX-License-Identifier: GPL-3.0-or-later
"""Separate ground seen through the building from ground mirrored in its panes.

The mirror image of level ground lies in the ground plane, so all photos of the same pane agree on it. Photos that see
that position beside the building, or from the other side, show what is really there, which differs from a mirror image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.geometry.ground_plane import GroundPlane
from mgf_engine.masks.geometry.plane_homography import homography
from mgf_engine.masks.refinement.lab_photos import LabPhotos
from mgf_engine.model.masks import BACKGROUND
from mgf_engine.model.scene import Scene
from mgf_engine.options.algorithms import parameter

Array = NDArray[np.float64]
_LEAST_WEIGHT = 1e-4  # of the compared pixels in a window, below which nothing is known
_MOST_ROWS = 1 << 14  # cv2.remap takes fewer than 1 << 15


@dataclass(frozen=True)
class MirroredGroundOptions:
    """Options of ground that is mirrored."""

    opposite: float = parameter(
        100.0, "Horizontal angle between two photos from which they do not look into the same pane", "degrees", high=180
    )
    least_angle: float = parameter(
        5.0, "Minimum horizontal angle to a photo that sees the ground beside the building", "degrees"
    )
    photos: int = parameter(40, "Maximum number of photos that a photo is compared with", low=2)
    best: int = parameter(3, "Number of compared photos, the best ones, whose mean correlation counts", low=1)
    correlation: float = parameter(0.5, "Minimum normalised cross-correlation of patches, mean of a window", high=1)
    texture: float = parameter(1.0, "Minimum standard deviation of a patch's lightness")
    step: int = parameter(3, "Distance between compared pixels", "px", low=1)
    spread: float = parameter(
        8.0, "Standard deviation of the window over which correlations are averaged", "px", low=0.1
    )
    radius: int = parameter(3, "Half the side of the patches", "px", low=1)
    scales: tuple[float, float] = parameter((0.4, 2.5), "Ratio of the distances of two photos from the ground")
    beside: int = parameter(4, "Distance from a mask from which a photo sees the ground beside the building", "px")


class MirrorTest:
    """Compares ground in the masks with what photos from other sides show of it.

    Args:
        photos: of the scene, in CIELAB.
        ground: normalised frame.
        labels: label maps of all photos [H, W], as they are before any ground is cut out.
        options: which photos are compared, and how alike they must be.
    """

    def __init__(
        self,
        photos: LabPhotos,
        ground: GroundPlane,
        labels: Sequence[NDArray[np.uint8]],
        options: MirroredGroundOptions = MirroredGroundOptions(),
    ) -> None:
        self.photos, self.ground, self.options = photos, ground, options
        self.scene: Scene = photos.scene
        side = 2 * options.beside + 1
        # At a quarter of the size: which pixels are near the mask.
        self._near_mask = [
            cv2.resize(
                cv2.dilate((label != BACKGROUND).astype(np.uint8), np.ones((side, side), np.uint8)),
                (-(-label.shape[1] // 4), -(-label.shape[0] // 4)), interpolation=cv2.INTER_NEAREST,
            ) for label in labels
        ]  # fmt: skip

    def confirmed(self, index: int, found: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return what photos from other sides confirm of the ground found in a photo, [H, W].

        Args:
            index: of the view.
            found: pixels that show the plane of the ground, bool [H, W].
        """
        options, view, result = self.options, self.scene.views[index], np.zeros_like(found)
        pixels = _grid(found, options)
        if not len(pixels):
            return result
        depth = self.ground.depth(view, view.height, view.width)[pixels[:, 1], pixels[:, 0]]
        score = self._agreement(index, pixels, view.unproject(pixels + 0.5, depth))
        known = np.isfinite(score)
        total, weight = np.zeros((2, *found.shape), np.float32)
        x, y = pixels[known].T
        total[y, x], weight[y, x] = score[known], 1.0
        total, weight = (cv2.GaussianBlur(part, (0, 0), options.spread) for part in (total, weight))
        return np.asarray(found & (total > options.correlation * weight) & (weight > _LEAST_WEIGHT), bool)

    def _agreement(self, index: int, pixels: NDArray[np.int64], places: Array) -> Array:
        """Compute the mean correlation with the best of the photos from other sides, NaN where too few see it, [N].

        Args:
            index: of the view.
            pixels: x, y of the middles of its patches, [N, 2].
            places: on the ground, [N, 3].
        """
        options, window = self.options, _window(self.options.radius)
        own = _patches(self._light(index), pixels[:, None] + window)
        result = np.full((len(pixels), options.photos), np.nan)
        for column, other in enumerate(self._others(index, places)):
            rows = np.flatnonzero(self._sees(index, other, places))
            if not len(rows):
                continue
            matrix = homography(self.scene.views[index], self.scene.views[other], self.ground)
            flat = pixels[rows, None] + window
            at = np.concatenate([flat, np.ones_like(flat[..., :1])], -1) @ matrix.T
            theirs = _patches(self._light(other), at[..., :2] / at[..., 2:])
            result[rows, column] = _correlation(own[rows], theirs, options.texture)
        best = np.sort(np.where(np.isfinite(result), result, -1.0), axis=1)[:, -options.best :]
        return np.where(np.isfinite(result).sum(1) >= options.best, best.mean(1), np.nan)

    def _others(self, index: int, places: Array) -> list[int]:
        """Choose photos from beside and from the other side of the middle of the places, half of each at most."""
        options, middle = self.options, np.median(places, axis=0)
        centres = np.stack([view.centre for view in self.scene.views])
        angle = self._angle(centres[index] - middle, centres - middle)
        order = np.argsort(angle, kind="stable")
        beside = [int(i) for i in order if options.least_angle < angle[i] <= options.opposite]
        opposite = [int(i) for i in order if angle[i] > options.opposite]
        return beside[: options.photos // 2] + opposite[: options.photos // 2]

    def _sees(self, index: int, other: int, places: Array) -> NDArray[np.bool_]:
        """Tell whether another photo shows places [N, 3] beside the building or from its other side, bool [N]."""
        options, view = self.options, self.scene.views[other]
        uv, _, framed = view.project_into_frame(places, margin=3 * options.radius)
        own, theirs = self.scene.views[index].centre - places, view.centre - places
        scale = np.linalg.norm(theirs, axis=1) / np.linalg.norm(own, axis=1)
        framed &= (scale > options.scales[0]) & (scale < options.scales[1])
        near = self._near_mask[other]
        x, y = np.clip(np.nan_to_num(uv) // 4, 0, np.array(near.shape[::-1]) - 1).astype(np.int64).T
        return np.asarray(framed & ((near[y, x] == 0) | (self._angle(own, theirs) > options.opposite)), bool)

    def _angle(self, first: Array, second: Array) -> Array:
        """Compute the horizontal angle between directions [3] or [N, 3] each, degrees [N]."""
        normal = self.ground.normal / np.linalg.norm(self.ground.normal)
        first, second = (d - (d @ normal)[..., None] * normal for d in (first, second))
        length = np.linalg.norm(first, axis=-1) * np.linalg.norm(second, axis=-1)
        cosine = (first * second).sum(-1) / np.maximum(length, 1e-12)
        return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1, 1))), np.float64)

    def _light(self, index: int) -> NDArray[np.float32]:
        """Return the lightness of a photo, 0..100, [H, W]."""
        return self.photos.lightness(index).astype(np.float32) * np.float32(100 / 255)


def _grid(found: NDArray[np.bool_], options: MirroredGroundOptions) -> NDArray[np.int64]:
    """Choose the found pixels (x, y) of a grid whose patches lie within the photo, [N, 2]."""
    inner = slice(options.radius, -options.radius, options.step)
    y, x = np.nonzero(found[inner, inner])
    return np.stack([x, y], 1) * options.step + options.radius


def _window(radius: int) -> NDArray[np.int64]:
    """Return the steps (x, y) from the middle of a patch to its pixels, [P, 2]."""
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    return np.stack([x.ravel(), y.ravel()], 1)


def _patches(light: NDArray[np.float32], at: NDArray[np.generic]) -> NDArray[np.float32]:
    """Interpolate a picture at places x, y [N, P, 2], [N, P]."""
    x, y = np.ascontiguousarray(np.moveaxis(at.astype(np.float32), -1, 0))
    blocks = [slice(begin, begin + _MOST_ROWS) for begin in range(0, len(x), _MOST_ROWS)]
    return np.concatenate([cv2.remap(light, x[b], y[b], cv2.INTER_LINEAR) for b in blocks])


def _correlation(own: NDArray[np.float32], other: NDArray[np.float32], texture: float) -> Array:
    """Compute the normalised cross-correlation of patches [N, P], 0 where one has no texture, [N]."""
    a, b = own - own.mean(1, keepdims=True), other - other.mean(1, keepdims=True)
    spread = np.sqrt((a**2).mean(1)), np.sqrt((b**2).mean(1))
    result = (a * b).mean(1) / np.maximum(spread[0] * spread[1], 1e-9)
    return np.asarray(np.where((spread[0] > texture) & (spread[1] > texture / 2), result, 0.0), np.float64)
