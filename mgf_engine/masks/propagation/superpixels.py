# SPDX-License-Identifier: GPL-3.0-or-later
"""Divide a photo into superpixels (SLIC) with features: the nodes of the label graph.

A photo at 1000 px has 700,000 pixels but about 1,800 superpixels, so that all photos of a scene fit into one graph.
Segmenters and the skyline refine the edges at working resolution afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.image_ops import rgb_to_lab
from mgf_engine.model.pixels import pixel_at
from mgf_engine.native.library import call
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class SuperpixelOptions:
    """Options of the superpixels (SLIC)."""

    reduced_side: int = parameter(500, "Longest side of the reduced photo on which superpixels are cut", "px", low=16)
    side: int = parameter(10, "Mean side of a superpixel on the reduced photo", "px", low=2)
    compactness: float = parameter(
        12.0, "Colour distance (8-bit CIELAB) that separates pixels like a distance of one side", low=0.1
    )
    rounds: int = parameter(6, "Number of iterations", low=1)
    speck: int = parameter(20, "Size below which a piece joins a neighbour, in percent of the usual size", high=100)


_CROSS = np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])


@dataclass(frozen=True)
class Superpixels:
    """Superpixels of one photo; ``S`` regions, ``E`` pairs of neighbours.

    Attributes:
        labels: int32 [h, w] on the reduced photo, 0..S-1.
        scale: (x, y) factor from working pixels to reduced pixels.
        features: float32 [S, 6]: mean L, a, b (CIELAB, 0..100 and about -110..110), fine texture, coarse
            texture (log of the mean gradient at two scales), spread of L.
        centres: float32 [S, 2] in working pixels.
        area: float32 [S], share of the photo's pixels, sums to 1.
        top: float32 [S], share of the photo's width at which the region touches the top.
        pairs: int32 [E, 2] neighbouring regions.
        border: float32 [E] length of the common border in reduced pixels.
        contrast: float32 [E] colour difference across it.
    """

    labels: NDArray[np.int32]
    scale: tuple[float, float]
    features: NDArray[np.float32]
    centres: NDArray[np.float32]
    area: NDArray[np.float32]
    top: NDArray[np.float32]
    pairs: NDArray[np.int32]
    border: NDArray[np.float32]
    contrast: NDArray[np.float32]

    def at(self, uv: NDArray[np.floating]) -> NDArray[np.int32]:
        """Look up the region under working pixels [N, 2] (clamped to the frame), [N]."""
        return self.labels[pixel_at(self.labels.shape, uv * np.asarray(self.scale, uv.dtype))]

    def at_cross(self, uv: NDArray[np.float64], arm: float) -> NDArray[np.int32]:
        """Look up the regions under a working pixel [2] and ``arm`` pixels left, right, above and below, [5]."""
        return self.at(uv + arm * _CROSS)


def cut_regions(photo: NDArray[np.uint8], options: SuperpixelOptions = SuperpixelOptions()) -> Superpixels:
    """Return regions of a photo, RGB uint8 [H, W, 3]."""
    h, w = photo.shape[:2]
    factor = min(1.0, options.reduced_side / max(h, w))
    size = (max(1, round(w * factor)), max(1, round(h * factor)))
    small = np.asarray(cv2.resize(photo, size, interpolation=cv2.INTER_AREA), np.uint8)
    lab = rgb_to_lab(small)
    labels = _superpixels(small, options)
    count = int(labels.max()) + 1
    flat = labels.ravel()
    pixels = np.bincount(flat, minlength=count).astype(np.float32)
    features = _features(lab, flat, pixels)
    ys, xs = np.mgrid[0 : size[1], 0 : size[0]].astype(np.float32) + 0.5
    centres = np.stack([np.bincount(flat, c.ravel(), count) / pixels for c in (xs, ys)], 1)
    pairs, border, contrast = _neighbours(labels, lab)
    return Superpixels(
        labels=labels,
        scale=(size[0] / w, size[1] / h),
        features=features,
        centres=(centres * (w / size[0], h / size[1])).astype(np.float32),
        area=pixels / pixels.sum(),
        top=(np.bincount(labels[0], minlength=count) / size[0]).astype(np.float32),
        pairs=pairs,
        border=border,
        contrast=contrast,
    )


def _superpixels(small: NDArray[np.uint8], options: SuperpixelOptions) -> NDArray[np.int32]:
    """Compute SLIC labels 0..S-1 without gaps; tiny photos become one region per pixel block."""
    if min(small.shape[:2]) < 2 * options.side:
        h, w = small.shape[:2]
        ys, xs = np.mgrid[0:h, 0:w] // 2
        return (ys * ((w + 1) // 2) + xs).astype(np.int32)
    smooth = cv2.GaussianBlur(small, (3, 3), 0.7)
    labels = np.empty(small.shape[:2], np.int32)
    picture = np.ascontiguousarray(cv2.cvtColor(smooth, cv2.COLOR_RGB2LAB))
    if call(
        "mgf_superpixels",
        *labels.shape,
        picture,
        options.side,
        options.compactness,
        options.rounds,
        options.speck,
        labels,
    ):
        raise MemoryError("Not enough memory to cut the photo into regions; work at a lower resolution.")
    return labels


def _features(lab: NDArray[np.float32], flat: NDArray[np.int32], pixels: NDArray[np.float32]) -> NDArray[np.float32]:
    count = len(pixels)
    light = lab[..., 0]
    planes = [lab[..., c] for c in range(3)] + [_gradient(light, 0.0), _gradient(light, 2.0), light * light]
    means = np.stack([np.bincount(flat, p.ravel(), count) / pixels for p in planes], 1)
    spread = np.sqrt(np.maximum(means[:, 5] - means[:, 0] ** 2, 0))
    texture = np.log1p(means[:, 3:5])
    return np.concatenate([means[:, :3], texture, np.log1p(spread)[:, None]], 1).astype(np.float32)


def _gradient(light: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    """Return gradient magnitude, averaged over a small neighbourhood so that it describes texture, not one edge."""
    base = cv2.GaussianBlur(light, (0, 0), sigma) if sigma else light
    gx, gy = cv2.Sobel(base, cv2.CV_32F, 1, 0, scale=0.25), cv2.Sobel(base, cv2.CV_32F, 0, 1, scale=0.25)
    return np.asarray(cv2.blur(np.sqrt(gx * gx + gy * gy), (7, 7)), np.float32)


def _neighbours(
    labels: NDArray[np.int32], lab: NDArray[np.float32]
) -> tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]]:
    """Return the pairs of touching regions, their border length, and the mean colour step across the border."""
    firsts, seconds, steps = [], [], []
    blurred = cv2.GaussianBlur(lab, (0, 0), 1.0)
    for axis in (0, 1):
        a, b = (labels[:-1], labels[1:]) if axis == 0 else (labels[:, :-1], labels[:, 1:])
        # The step over four pixels: soft edges of reduced photos count in full.
        pad = [(2, 1), (0, 0)] if axis == 0 else [(0, 0), (2, 1)]
        wide = np.pad(blurred, [*pad, (0, 0)], mode="edge")
        n = labels.shape[axis] - 1
        low = wide[:n] if axis == 0 else wide[:, :n]
        high = wide[4 : 4 + n] if axis == 0 else wide[:, 4 : 4 + n]
        if low.shape != high.shape:
            high = np.take(wide, np.minimum(np.arange(n) + 4, wide.shape[axis] - 1), axis=axis)
        touching = a != b
        one, other = a[touching], b[touching]
        firsts.append(np.minimum(one, other))
        seconds.append(np.maximum(one, other))
        steps.append(np.sqrt(((high[touching] - low[touching]) ** 2).sum(-1)))
    first, second, step = np.concatenate(firsts), np.concatenate(seconds), np.concatenate(steps)
    count = int(labels.max()) + 1
    key, inverse, border = np.unique(first.astype(np.int64) * count + second, return_inverse=True, return_counts=True)
    contrast = np.bincount(inverse, step, len(key)) / np.maximum(border, 1)
    pairs = np.stack([key // count, key % count], 1).astype(np.int32)
    return pairs, border.astype(np.float32), contrast.astype(np.float32)
