# SPDX-License-Identifier: GPL-3.0-or-later
"""Extend the mask to the edges of homogeneous regions that its boundary crosses.

Label propagation needs edges and points, and a textureless wall has neither: its foot or a corner may be cut off where
the photo shows no edge. A region without edges is one surface, so if most of it is building, the rest is filled up to
the nearest edge.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from mgf_engine.masks.image_ops import dilate, erode
from mgf_engine.model.masks import BACKGROUND, IGNORE
from mgf_engine.model.pixels import pixel_at
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class HomogeneousRegionOptions:
    """Options of the completion of homogeneous regions."""

    edge: float = parameter(2.0, "Gradient (CIELAB per px) from which a pixel is an edge")
    gap: int = parameter(2, "Half the width of gaps between edges that regions do not leak through", "px")
    smallest: int = parameter(200, "Minimum area of a region", "px²")
    building: float = parameter(0.6, "Share of a region that must be building", high=1)
    color: float = parameter(8.0, "Maximum difference (CIELAB) from the nearest building pixel of the region")
    contact: float = parameter(0.3, "Share of a patch's outline that must touch the mask", high=1)
    depth: float = parameter(
        0.05, "Maximum reach of a patch from the mask, as a share of the photo's longer side", high=1
    )
    click_reach: int = parameter(6, "Maximum distance of a click from the region that it means", "px")
    largest: float = parameter(0.25, "Maximum area of a region that the preview fills, as a share of the photo", high=1)


def find_missing_pixels(
    lab: NDArray[np.float32],
    labels: NDArray[np.uint8],
    sky: NDArray[np.bool_],
    negative: NDArray[np.floating],
    options: HomogeneousRegionOptions = HomogeneousRegionOptions(),
) -> NDArray[np.bool_]:
    """Find background and ignored pixels that belong to the building by their homogeneous region, bool [H, W].

    Args:
        lab: CIELAB of the photo, float32 [H, W, 3].
        labels: label map, uint8 [H, W], see :mod:`mgf_engine.model.masks`.
        sky: bool [H, W].
        negative: clicks on the background, pixels [N, 2]; a patch that holds one stays as it is.
        options: what counts as homogeneous, and how far a region may reach from the mask.
    """
    mask = (labels != BACKGROUND) & (labels != IGNORE)
    region, _, mostly = _find_regions(lab, mask, options)
    mostly[0] = False  # edges
    chosen = mostly[region]
    source = mask & chosen
    if not source.any():
        return np.zeros(labels.shape, bool)
    reach = options.gap + 1
    wide = chosen | (dilate(chosen, reach) & ~dilate((region > 0) & ~chosen, reach))
    distance, (row, column) = distance_transform_edt(~source, return_indices=True)
    smooth = cv2.GaussianBlur(lab, (0, 0), 1.5)
    alike = np.linalg.norm(smooth - smooth[row, column], axis=-1) < options.color
    return _attached(wide & alike & ~mask & ~sky, mask, distance, negative, options)


def find_clicked_regions(
    lab: NDArray[np.float32],
    mask: NDArray[np.bool_],
    positive: NDArray[np.floating],
    negative: NDArray[np.floating],
    options: HomogeneousRegionOptions = HomogeneousRegionOptions(),
) -> NDArray[np.bool_]:
    """Find the homogeneous regions that clicks mean or that are mostly building, up to their edges, bool [H, W].

    Sparse points lie around the windows of a plain wall and nowhere else on it. Regions that hold a click beside the
    building, that reach the top of the photo (sky) or that fill too much of it are left out.

    Args:
        lab: CIELAB of the photo, float32 [H, W, 3].
        mask: of the building, bool [H, W].
        positive: clicks on the building, pixels [N, 2].
        negative: clicks beside it, pixels [M, 2].
        options: what counts as homogeneous, and how large a region may be.
    """
    region, size, chosen = _find_regions(lab, mask, options)
    chosen[[_region_at(region, click, options.click_reach) for click in positive]] = True
    chosen &= size <= options.largest * region.size
    chosen[[_region_at(region, click, options.gap) for click in negative]] = False
    chosen[region[0]] = False
    chosen[0] = False  # edges
    wanted = chosen[region]
    others = dilate((region > 0) & ~wanted, max(1, options.gap - 1))
    return np.asarray(dilate(wanted, options.gap + 1) & ~others, bool)


def _find_regions(
    lab: NDArray[np.float32], mask: NDArray[np.bool_], options: HomogeneousRegionOptions
) -> tuple[NDArray, NDArray[np.int64], NDArray[np.bool_]]:
    """Return the region of each pixel (0 at edges), the pixels of each region, and which are mostly in the mask."""
    flat = np.linalg.norm(_gradient(lab), axis=-1) < options.edge
    count, region = cv2.connectedComponents(erode(flat, options.gap).astype(np.uint8), connectivity=4)
    size = np.bincount(region.ravel(), minlength=count)
    inside = np.bincount(region[mask], minlength=count)
    return region, size, (inside >= options.building * size) & (size >= options.smallest)


def _region_at(region: NDArray, click: NDArray[np.floating], reach: int) -> int:
    """Return the region that takes most of the square around a click; 0 where there is none."""
    y, x = pixel_at(region.shape, click[None])
    part = region[max(0, y[0] - reach) : y[0] + reach + 1, max(0, x[0] - reach) : x[0] + reach + 1]
    return int(np.bincount(part[part > 0], minlength=1).argmax())


def _gradient(lab: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the derivatives of all channels in both directions, per pixel, [H, W, 6]."""
    smooth = cv2.GaussianBlur(lab, (0, 0), 0.8)
    return np.concatenate([cv2.Sobel(smooth, cv2.CV_32F, dx, 1 - dx, ksize=3, scale=1 / 8) for dx in (0, 1)], axis=-1)


def _attached(
    patches: NDArray[np.bool_],
    mask: NDArray[np.bool_],
    distance: NDArray[np.float64],
    negative: NDArray[np.floating],
    options: HomogeneousRegionOptions,
) -> NDArray[np.bool_]:
    """Return connected patches that touch the mask along enough of their outline and reach not too far from it."""
    count, patch = cv2.connectedComponents(patches.astype(np.uint8), connectivity=4)
    outline = patches & ~erode(patches, 1)
    length = np.bincount(patch[outline], minlength=count)
    touching = np.bincount(patch[outline & dilate(mask, 1)], minlength=count)
    farthest = np.zeros(count)
    np.maximum.at(farthest, patch[patches].astype(np.int64), distance[patches])
    kept = (touching >= options.contact * length) & (farthest < options.depth * max(mask.shape))
    kept[0] = False
    kept[patch[pixel_at(mask.shape, negative)]] = False
    return np.asarray(kept[patch], bool)
