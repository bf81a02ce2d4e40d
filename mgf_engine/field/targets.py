# SPDX-License-Identifier: GPL-3.0-or-later
"""Training target of a view: photo, labels and pixel weights, cropped to the building."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mgf_engine.masks.boundaries import boundaries
from mgf_engine.model.masks import BACKGROUND, BUILDING, building
from mgf_engine.model.scene import View
from mgf_engine.options.algorithms import parameter
from mgf_engine.options.config import job_option
from mgf_engine.raster.camera import TILE, Camera
from mgf_engine.raster.loss import LossPhoto
from mgf_engine.raster.loss_photo import prepare_photo


@dataclass(frozen=True)
class TargetOptions:
    """Options of the margin and the background that are trained besides the building."""

    least_gap: float = parameter(8.0, "Width from which a gap in the mask has a margin inside, in margins")
    background_band: int = parameter(24, "Width of the band around the building that is kept empty", "px", low=2)
    gradient_limits: tuple[float, float] = parameter(
        (0.25, 4.0), "Smallest and largest weight of a mask by its gradient, relative to the mean, eq. 19", low=1e-6
    )
    masked_images: bool = job_option("masked_images")
    margin: float = job_option("mask_margin")
    boundary_weight: float = job_option("boundary_weight")
    background_lambda: float = job_option("background_lambda")


@dataclass(frozen=True)
class Pixels:
    """A target's maps as floats, cut to its box.

    Attributes:
        photo: float [3, h, w] in 0..1.
        labels: int64 [h, w]; 0 where nothing is compared, 1 on the building where it is no element, 2..elements on its
            elements (ids made consecutive), then one more on the margin: of background, or the rest of a whole photo.
        inside: float [h, w]; 1 on the building and its margin.
        edge_weight: float [h, w]; w of eq. 12, zero outside; 1 on the margin, which is no part of the building.
        background_band: float [h, w]; 1 on certain background near the building, which is kept empty.
    """

    photo: Tensor
    labels: Tensor
    inside: Tensor
    edge_weight: Tensor
    background_band: Tensor


@dataclass(frozen=True)
class Target:
    """One view at one resolution, kept small: a hundred photos stay in memory. Maps are cut to ``box``.

    Attributes:
        camera: of the whole frame at this resolution.
        tile_mask: uint8 [tiles_y, tiles_x]; tiles of the whole frame that hold a pixel that counts.
        box: y0, y1, x0, x1, aligned to tiles.
        image: uint8 [3, h, w].
        labels: uint8 [h, w], see :class:`Pixels`.
        elements: labels 1..elements are the building.
        count: highest of the labels; one more than ``elements`` where there is a margin.
        edges: bool [h, w]; boundaries of the masks, w_edge of eq. 12 weighs them.
        background_band: bool [h, w], see :class:`Pixels`.
        w_edge: eq. 12.
        gradient_limits: smallest and largest delta of eq. 19.
    """

    camera: Camera
    tile_mask: Tensor
    box: tuple[int, int, int, int]
    image: Tensor
    labels: Tensor
    elements: int
    count: int
    edges: Tensor
    background_band: Tensor
    w_edge: float
    gradient_limits: tuple[float, float]

    def to(self, device: torch.device) -> Target:
        """Move what every rendering reads to a device; the photo follows on first use."""
        return replace(self, tile_mask=self.tile_mask.to(device))

    def crop(self, plane: Tensor) -> Tensor:
        """Cut a rendered map [..., H, W] to the box, [..., h, w]."""
        y0, y1, x0, x1 = self.box
        return plane[..., y0:y1, x0:x1]

    @cached_property
    def loss_photo(self) -> LossPhoto:
        """The same maps as the loss kernels read them."""
        origin = (self.box[0], self.box[2])
        maps = self.image, self.labels, self.edges, self.background_band
        return prepare_photo(*maps, self.count + 1, self.elements, origin)

    @cached_property
    def label_weight(self) -> Tensor:
        """Area times delta of eq. 19 per mask, summing to one: float32 [count + 1].

        Entry 0 is the whole building (level one), the others are its elements (level two); zero for the margin and for
        label 1, which is no mask but what the elements leave of the building.
        """
        photo = np.ascontiguousarray(self.image.numpy().transpose(1, 2, 0))
        found = _label_weights(photo, self.labels.numpy(), self.elements, self.count, self.gradient_limits)
        return torch.from_numpy(found)

    def pixels(self, dtype: torch.dtype = torch.float32) -> Pixels:
        """Convert the maps to floats."""
        inside = (self.labels > 0).to(dtype)
        return Pixels(
            photo=self.image.to(dtype) / 255.0,
            labels=self.labels.long(),
            inside=inside,
            edge_weight=torch.where(self.edges, inside * self.w_edge, inside),
            background_band=self.background_band.to(dtype),
        )


def make_target(
    photo: NDArray[np.uint8],
    labels: NDArray[np.uint8],
    view: View,
    factor: int,
    options: TargetOptions = TargetOptions(),
) -> Target | None:
    """Make the target of one view; None when no building pixel is left.

    Args:
        photo: RGB uint8 [H, W, 3] at working resolution.
        labels: uint8 [H, W], see :mod:`mgf_engine.model.masks`.
        view: camera of the photo.
        factor: by which photo and labels are reduced.
        options: of margin, band and weights.
    """
    camera = Camera.from_view(view, 1.0 / factor)
    size = (camera.width, camera.height)
    if factor > 1:
        photo = np.asarray(cv2.resize(photo, size, interpolation=cv2.INTER_AREA), np.uint8)
        labels = np.asarray(cv2.resize(labels, size, interpolation=cv2.INTER_NEAREST), np.uint8)
    if not building(labels).any():
        return None
    own = building(labels)
    margin = ~own
    if options.masked_images:
        margin = margin_around(labels, options.margin * max(size), options.least_gap)
    inside = own | margin
    background_band = _band(inside, labels, max(2, options.background_band // factor))
    box = _tile_box(inside | background_band)  # also without a background loss: windows of SSIM reach over the outline
    if options.background_lambda == 0:
        background_band[:] = False
    cut = (slice(*box[:2]), slice(*box[2:]))
    photo, labels, own, margin, background_band = photo[cut], labels[cut], own[cut], margin[cut], background_band[cut]
    compact, elements = _consecutive(labels, own)
    compact[margin] = elements + 1
    return Target(
        camera=camera,
        tile_mask=_tile_mask(own | margin | background_band, box, camera),
        box=box,
        image=torch.from_numpy(np.ascontiguousarray(photo.transpose(2, 0, 1))),
        labels=torch.from_numpy(compact),
        elements=elements,
        count=elements + int(margin.any()),
        edges=torch.from_numpy(boundaries(labels) & own),
        background_band=torch.from_numpy(np.ascontiguousarray(background_band)),
        w_edge=options.boundary_weight,
        gradient_limits=options.gradient_limits,
    )


def margin_around(labels: NDArray[np.uint8], width: float, least_gap: float = 8.0) -> NDArray[np.bool_]:
    """Find the certain background that is trained along with the building, bool [H, W].

    Masks of neighbouring photos disagree by some pixels at their outlines. A field that is emptied right outside one
    of them has holes there in the next; with a margin the outline is trained on both of its sides, and the votes of
    all masks cut the mesh in the end. Bars thinner than two margins have none, and neither have narrow gaps: there,
    more of what is behind would be trained than of the building, and stay as fog.

    Args:
        labels: uint8 [H, W].
        width: of the margin, px.
        least_gap: width from which a gap in the mask has a margin inside, in margins.
    """
    inside = building(labels)
    near = _distance(_thick(inside, width)) <= width
    return (labels == BACKGROUND) & near & _thick(~inside, least_gap / 2 * width)


def _thick(mask: NDArray[np.bool_], radius: float) -> NDArray[np.bool_]:
    """Return the mask without what is narrower than twice the radius; its corners stay."""
    return mask & (_distance(_distance(~mask) > radius) <= 1.5 * radius)


def _distance(mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the distance of every pixel to the mask, px; large where there is none."""
    return np.asarray(cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 3), np.float32)


def _band(inside: NDArray[np.bool_], labels: NDArray[np.uint8], width: int) -> NDArray[np.bool_]:
    """Return certain background at most ``width`` px from the building, and two px clear of its edge."""
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


def _consecutive(labels: NDArray[np.uint8], own: NDArray[np.bool_]) -> tuple[NDArray[np.uint8], int]:
    """Renumber the labels of the building: 1 where it is no element, its elements 2..n in their order, 0 outside; and
    n."""
    there = np.bincount(labels[own], minlength=256) > 0
    there[BUILDING] = True
    name = np.cumsum(there).astype(np.uint8)
    return np.where(own, name[labels], 0).astype(np.uint8), int(there.sum())


def _label_weights(
    photo: NDArray[np.uint8], labels: NDArray[np.uint8], elements: int, count: int, limits: tuple[float, float]
) -> NDArray[np.float32]:
    """Compute per mask its area times delta_k (eq. 19); see :attr:`Target.label_weight`.

    delta_k is the inverse of the mean gradient inside the eroded mask (so that the mask's own outline does not
    count), clipped, and scaled so that the weights sum to one.
    """
    grey = cv2.cvtColor(photo, cv2.COLOR_RGB2GRAY).astype(np.float32) / 255.0
    magnitude = np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0, scale=0.125), cv2.Sobel(grey, cv2.CV_32F, 0, 1, scale=0.125))
    whole = ((labels > 0) & (labels <= elements)).astype(np.uint8)
    area, core_area, gradient = (
        np.concatenate([a[1:2], b[1:]])
        for a, b in zip(_cores(whole, magnitude, 1), _cores(labels, magnitude, count), strict=True)
    )
    area[1] = core_area[1] = 0.0
    area[elements + 1 :] = core_area[elements + 1 :] = 0.0
    typical = (gradient * core_area).sum() / max(core_area.sum(), 1)
    delta = np.clip((typical + 1e-6) / (gradient + 1e-6), *limits)
    delta[core_area == 0] = 1.0
    weight = delta * area
    return np.asarray(weight / weight.sum(), np.float32)


def _cores(
    labels: NDArray[np.uint8], magnitude: NDArray[np.float32], count: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Compute per label 0..count its area, that of it without its outline, and the mean of ``magnitude`` over the
    latter."""
    kernel = np.ones((3, 3), np.uint8)
    core = (cv2.erode(labels, kernel) == labels) & (cv2.dilate(labels, kernel) == labels) & (labels > 0)
    area = np.bincount(labels.ravel(), minlength=count + 1).astype(np.float64)
    core_area = np.bincount(labels[core], minlength=count + 1).astype(np.float64)
    gradient = np.bincount(labels[core], weights=magnitude[core], minlength=count + 1) / np.maximum(core_area, 1)
    return area, core_area, gradient
