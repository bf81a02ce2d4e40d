# SPDX-License-Identifier: GPL-3.0-or-later
"""What one training view is compared with: photo, labels and pixel weights, cut to the box that matters."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mgf_engine.config import Config
from mgf_engine.masks.boundaries import boundaries
from mgf_engine.masks.model import BACKGROUND, UNKNOWN, building
from mgf_engine.raster.camera import TILE, Camera
from mgf_engine.raster.loss import PhotoSide, photo_side
from mgf_engine.scene.model import View

_OPEN = 8  # rims that a gap in the mask must be wide to have a rim inside it
_RING = 24  # px of certain background around the building that is kept empty
_GRADIENT_LIMITS = (0.25, 4.0)


@dataclass(frozen=True)
class Pixels:
    """A target's maps as floats, cut to its box.

    Attributes:
        photo: float [3, h, w] in 0..1.
        labels: int64 [h, w]; 0 where nothing is compared, else 1..count (ids made consecutive).
        inside: float [h, w]; 1 on the building and its rim.
        edge_weight: float [h, w]; w of eq. 12, zero outside.
        ring: float [h, w]; 1 on certain background near the building.
    """

    photo: Tensor
    labels: Tensor
    inside: Tensor
    edge_weight: Tensor
    ring: Tensor


@dataclass(frozen=True)
class Target:
    """One view at one resolution, kept small: a hundred photos stay in memory. Maps are cut to ``box``.

    Attributes:
        camera: of the whole frame at this resolution.
        tile_mask: uint8 [tiles_y, tiles_x]; tiles of the whole frame that hold a pixel that counts.
        box: y0, y1, x0, x1, aligned to tiles.
        image: uint8 [3, h, w].
        labels: uint8 [h, w], see :class:`Pixels`.
        count: highest of the labels.
        edges, ring: bool [h, w].
        w_edge: eq. 12.
    """

    camera: Camera
    tile_mask: Tensor
    box: tuple[int, int, int, int]
    image: Tensor
    labels: Tensor
    count: int
    edges: Tensor
    ring: Tensor
    w_edge: float

    def to(self, device: torch.device) -> Target:
        """The same for renderings on a device: what each rendering reads lies there; the photo follows on first use."""
        return replace(self, tile_mask=self.tile_mask.to(device))

    def crop(self, plane: Tensor) -> Tensor:
        """A rendered map [..., H, W] cut to the box."""
        y0, y1, x0, x1 = self.box
        return plane[..., y0:y1, x0:x1]

    @cached_property
    def photo_side(self) -> PhotoSide:
        """The same maps as the loss kernels take them."""
        origin = (self.box[0], self.box[2])
        return photo_side(self.image, self.labels, self.edges, self.ring, self.count + 1, origin)

    @cached_property
    def label_weight(self) -> Tensor:
        """Area share times delta of eq. 19 per label, summing to one: float32 [count + 1]."""
        photo = np.ascontiguousarray(self.image.numpy().transpose(1, 2, 0))
        return torch.from_numpy(_label_weights(photo, self.labels.numpy(), self.count))

    def pixels(self, dtype: torch.dtype = torch.float32) -> Pixels:
        """The maps as floats."""
        inside = (self.labels > 0).to(dtype)
        return Pixels(
            photo=self.image.to(dtype) / 255.0,
            labels=self.labels.long(),
            inside=inside,
            edge_weight=torch.where(self.edges, inside * self.w_edge, inside),
            ring=self.ring.to(dtype),
        )


def make_target(
    photo: NDArray[np.uint8], labels: NDArray[np.uint8], view: View, factor: int, config: Config
) -> Target | None:
    """The target of one view reduced by ``factor``; None when no building pixel is left.

    Args:
        photo: RGB uint8 [H, W, 3] at working resolution.
        labels: uint8 [H, W], see :mod:`mgf_engine.masks.model`.
    """
    camera = Camera.from_view(view, 1.0 / factor)
    size = (camera.width, camera.height)
    if factor > 1:
        photo = np.asarray(cv2.resize(photo, size, interpolation=cv2.INTER_AREA), np.uint8)
        labels = np.asarray(cv2.resize(labels, size, interpolation=cv2.INTER_NEAREST), np.uint8)
    if not building(labels).any():
        return None
    labels = with_rim(labels, config.mask_margin * max(size))
    inside = building(labels)
    ring = _ring(inside, labels, max(2, _RING // factor))
    box = _tile_box(inside | ring)
    cut = (slice(*box[:2]), slice(*box[2:]))
    photo, labels, inside, ring = photo[cut], labels[cut], inside[cut], ring[cut]
    compact, count = _consecutive(labels, inside)
    return Target(
        camera=camera,
        tile_mask=_tile_mask(inside | ring, box, camera),
        box=box,
        image=torch.from_numpy(np.ascontiguousarray(photo.transpose(2, 0, 1))),
        labels=torch.from_numpy(compact),
        count=count,
        edges=torch.from_numpy(boundaries(labels)),
        ring=torch.from_numpy(np.ascontiguousarray(ring)),
        w_edge=config.boundary_weight,
    )


def with_rim(labels: NDArray[np.uint8], width: float) -> NDArray[np.uint8]:
    """Certain background up to ``width`` px from the building becomes an element of its own.

    Masks of neighbouring photos disagree by some pixels at their outlines. A field that is emptied right outside one
    of them misses there in the next; with a rim the outline is trained on both of its sides, and the mesh is cut by
    the votes of all masks in the end. Bars thinner than two rims have none, and neither have gaps narrower than
    :data:`_OPEN` rims: there more would be trained of what is behind than of the building, and stay as fog.
    """
    inside = building(labels)
    near = _distance(_thick(inside, width)) <= width
    rim = (labels == BACKGROUND) & near & _thick(~inside, _OPEN / 2 * width)
    free = np.flatnonzero(np.bincount(labels.ravel(), minlength=UNKNOWN)[:UNKNOWN] == 0)
    return np.where(rim, free[-1] if len(free) else UNKNOWN - 1, labels).astype(np.uint8)


def _thick(mask: NDArray[np.bool_], radius: float) -> NDArray[np.bool_]:
    """The mask without what is narrower than twice the radius; its corners stay."""
    return mask & (_distance(_distance(~mask) > radius) <= 1.5 * radius)


def _distance(mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Distance of every pixel to the mask, px; large where there is none."""
    return np.asarray(cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 3), np.float32)


def _ring(inside: NDArray[np.bool_], labels: NDArray[np.uint8], width: int) -> NDArray[np.bool_]:
    """Certain background at most ``width`` px from the building, and two px clear of its edge."""
    outside = (~inside).astype(np.uint8)
    distance = cv2.distanceTransform(outside, cv2.DIST_L2, 3)
    return (labels == BACKGROUND) & (distance > 2.0) & (distance <= width)


def _tile_box(counts: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    height, width = counts.shape
    rows, columns = np.flatnonzero(counts.any(1)), np.flatnonzero(counts.any(0))
    y0, y1 = rows[0] // TILE * TILE, min(height, -(-(rows[-1] + 1) // TILE) * TILE)
    x0, x1 = columns[0] // TILE * TILE, min(width, -(-(columns[-1] + 1) // TILE) * TILE)
    return int(y0), int(y1), int(x0), int(x1)


def _tile_mask(counts: NDArray[np.bool_], box: tuple[int, int, int, int], camera: Camera) -> Tensor:
    tiles_y, tiles_x = camera.tiles
    full = np.zeros((tiles_y * TILE, tiles_x * TILE), bool)
    full[box[0] : box[1], box[2] : box[3]] = counts
    tiles = full.reshape(tiles_y, TILE, tiles_x, TILE).any((1, 3))
    return torch.from_numpy(tiles.astype(np.uint8))


def _consecutive(labels: NDArray[np.uint8], inside: NDArray[np.bool_]) -> tuple[NDArray[np.uint8], int]:
    """Labels inside numbered 1..count in their order, 0 outside; and that count."""
    number = np.bincount(labels[inside], minlength=256) > 0
    name = np.cumsum(number).astype(np.uint8)
    return np.where(inside, name[labels], 0).astype(np.uint8), int(number.sum())


def _label_weights(photo: NDArray[np.uint8], labels: NDArray[np.uint8], count: int) -> NDArray[np.float32]:
    """Per label, its area share times delta_k (eq. 19).

    delta_k is the inverse of the mean gradient inside the eroded mask (so that the mask's own outline does not
    count), clipped, and scaled so that the shares sum to one.
    """
    grey = cv2.cvtColor(photo, cv2.COLOR_RGB2GRAY).astype(np.float32) / 255.0
    magnitude = np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0, scale=0.125), cv2.Sobel(grey, cv2.CV_32F, 0, 1, scale=0.125))
    kernel = np.ones((3, 3), np.uint8)
    core = (cv2.erode(labels, kernel) == labels) & (cv2.dilate(labels, kernel) == labels) & (labels > 0)
    area = np.bincount(labels.ravel(), minlength=count + 1).astype(np.float64)
    core_area = np.bincount(labels[core], minlength=count + 1)
    gradient = np.bincount(labels[core], weights=magnitude[core], minlength=count + 1) / np.maximum(core_area, 1)
    typical = (gradient * core_area).sum() / max(core_area.sum(), 1)
    delta = np.clip((typical + 1e-6) / (gradient + 1e-6), *_GRADIENT_LIMITS)
    delta[core_area == 0] = 1.0
    weight = delta * area
    weight[0] = 0.0
    return np.asarray(weight / weight.sum(), np.float32)
