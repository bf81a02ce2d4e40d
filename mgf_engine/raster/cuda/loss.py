# SPDX-License-Identifier: GPL-3.0-or-later
"""The training loss on a GPU: the counterpart of the kernels behind :mod:`mgf_engine.raster.loss`, which calls this.

Everything stays on the device: the pooled similarities become slopes there, and the terms are tensors that nobody
waits for.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from mgf_engine.native.cuda.launcher import At, Launcher, blocks
from mgf_engine.raster.map_gradients import count_planes, split_planes

if TYPE_CHECKING:
    from mgf_engine.raster.camera import Intrinsics
    from mgf_engine.raster.loss_inputs import LossPhoto, LossWeights

_SIDE = 16  # of a tile, csrc/cuda/loss.cuh, as everything up to _EDGES
_MAX_LEVELS, _SAVED, _OTHER_SUMS = 5, 4, 6


@dataclass(frozen=True)
class DevicePhoto:
    """A photo and its labels on the device, uploaded once.

    Attributes:
        image, labels, edges, background_band: as in :class:`mgf_engine.raster.loss_inputs.LossPhoto`.
        area: int32 [scales, ids], as there.
        shares: float64 [ids], weight of each label; in place of label 0, of the whole building.
        sizes: height and width of the box.
    """

    image: Tensor
    labels: Tensor
    edges: Tensor
    background_band: Tensor
    area: Tensor
    shares: Tensor
    sizes: tuple[int, int]

    @property
    def maps(self) -> tuple[Tensor, ...]:
        """struct Labels."""
        return self.labels, self.edges, self.background_band


def photo_on(device: torch.device, photo: LossPhoto, weights: LossWeights) -> DevicePhoto:
    """Return the photo on the device; uploaded on first use and kept with the photo."""
    key = (str(device), weights.labels.tobytes())
    if key not in photo.copies:
        maps = photo.image, photo.labels, photo.edges, photo.background_band
        image, labels, edges, background_band = (m.to(device) for m in maps)
        area = torch.from_numpy(photo.area).to(device, torch.int32).contiguous()
        shares = torch.from_numpy(weights.labels).to(device, torch.float64)
        height, width = photo.labels.shape
        photo.copies[key] = DevicePhoto(image, labels, edges, background_band, area, shares, (height, width))
    found: DevicePhoto = photo.copies[key]
    return found


@dataclass(frozen=True)
class Pyramid:
    """Levels of the comparison: struct Levels, tiles of each level, and floats of scratch memory."""

    packed: bytes
    count: int
    tiles: tuple[int, ...]
    sizes: tuple[tuple[int, int], ...]
    scratch: int


def pyramid(height: int, width: int, count: int) -> Pyramid:
    """Return ``count`` levels of a box, each half the size of the one before."""
    levels, tiles, sizes, first, floats = [], [], [], 0, 0
    for scale in range(count):
        h, w = height >> scale, width >> scale
        tiles_x, starts = -(-w // _SIDE), []
        for planes in (3, 3, 3 * _SAVED, 3 if scale else 0):
            starts.append(floats)
            floats += planes * h * w
        levels.append(struct.pack("@4i4q", h, w, tiles_x, first, *starts))
        tiles.append(-(-h // _SIDE) * tiles_x)
        sizes.append((h, w))
        first += tiles[-1]
    empty = struct.pack("@4i4q", *(0,) * 8)
    packed = struct.pack("@2i", count, first) + b"".join(levels) + empty * (_MAX_LEVELS - count)
    return Pyramid(packed, count, tuple(tiles), tuple(sizes), floats)


class DevicePass:
    """One comparison on the device: the kernels in order; see ``_Pass`` of :mod:`mgf_engine.raster.loss`.

    Args:
        maps: colour, alpha, then distortion and depth, normal where their factors are not zero; float32, rows equally
            far apart.
    """

    def __init__(
        self,
        launcher: Launcher,
        photo: LossPhoto,
        weights: LossWeights,
        backdrop: Tensor,
        error: Tensor,
        maps: list[Tensor],
    ) -> None:
        self.launcher, self.photo, self.weights, self.error = launcher, photo, weights, error
        self.on_device = photo_on(launcher.device, photo, weights)
        self.backdrop = [float(v) for v in backdrop]
        self.color, self.alpha, *others = maps
        self.distortion = others.pop(0) if weights.distortion > 0 else None
        self.depth: Tensor | None = others[0] if weights.normals > 0 else None
        self.normal: Tensor | None = others[1] if weights.normals > 0 else None
        self.levels = pyramid(*self.on_device.sizes, len(photo.levels) if weights.multilevel > 0 else 1)
        self.ids = photo.area.shape[1]
        self.inside = max(int(photo.area[0, 1:].sum()), 1)
        self.scratch = self._empty(torch.float32, self.levels.scratch)
        self.others = 2 * self.levels.count * self.ids  # where the sums that are not per label begin
        self.sums = torch.zeros(self.others + _OTHER_SUMS, dtype=torch.int64, device=launcher.device)
        self.gradient = torch.zeros(count_planes(weights), *self.alpha.shape, device=launcher.device)

    def run(self, camera: Intrinsics) -> tuple[Tensor, Tensor]:
        """Return the total (a scalar) and the terms [3] (colour, geometry, background); :meth:`gradients` has theirs
        then."""
        self._compose()
        slopes, similarity, edge = self._similarity() if self.weights.ssim > 0 else (None, None, 0.0)
        if slopes is not None and self.levels.count > 1:
            given = (self.levels.packed, self.on_device.maps, self.ids, (slopes, 0.0), self.scratch)
            self.launcher.launch("loss_coarse", sum(self.levels.tiles[1:]), *given)
        if self.depth is not None:
            self._normals(camera)
        self._finish(slopes, edge)
        parts, total = self._empty(torch.float32, 3), self._empty(torch.float32, 1)
        w = self.weights
        factors = (w.distortion / self.inside, w.normals, w.background / max(self.photo.band_area, 1))
        summed = (self.others, self.sums, similarity, tuple(map(float, factors)))
        self.launcher.launch("loss_total", 1, *summed, parts, total)
        return total[0], parts

    def gradients(self) -> list[Tensor]:
        """Return the gradients of the maps, in the order they came."""
        return split_planes(self.gradient, self.weights)

    def _empty(self, dtype: torch.dtype, *shape: int) -> Tensor:
        return torch.empty(shape, dtype=dtype, device=self.launcher.device)

    def _at_box(self, map: Tensor | None) -> At | None:
        """Return a map's first pixel in the box."""
        y, x = self.photo.origin
        return None if map is None else At(map, y * map.stride(-2) + x)

    @property
    def _maps(self) -> tuple[Any, ...]:
        """struct Maps."""
        images = [self._at_box(m) for m in (self.alpha, self.distortion, self.depth, self.normal)]
        return (*images, self.alpha.stride(0), 0 if self.normal is None else self.normal.stride(0))

    @property
    def _gradient(self) -> tuple[Any, ...]:
        """struct Gradient."""
        return (self.gradient, *self.gradient.shape[1:], *self.photo.origin)

    def _compose(self) -> None:
        photo = self.on_device
        color = (self._at_box(self.color), self.color.stride(0), self.color.stride(1), self._at_box(self.alpha))
        given = (*color, photo.image, photo.labels, tuple(self.backdrop), self.scratch)
        self.launcher.launch("loss_compose", blocks(math.prod(photo.sizes)), self.levels.packed, *given)
        for scale in range(1, self.levels.count):
            pixels = math.prod(self.levels.sizes[scale])
            self.launcher.launch("loss_halve", blocks(pixels), self.levels.packed, scale, self.scratch)

    def _similarity(self) -> tuple[Tensor, Tensor, float]:
        """Return slopes by label [scales, 2, ids], the SSIM terms (float64 [1]) and the extra slope of an edge."""
        photo, w, (base, edge) = self.on_device, self.weights, self._pixel_weights()
        given = (self.levels.packed, photo.maps, self.ids, self.scratch, self.sums)
        self.launcher.launch("loss_similarity", sum(self.levels.tiles), *given)
        slopes = self._empty(torch.float32, self.levels.count, 2, self.ids)
        similarity = self._empty(torch.float64, 1)
        factors = (w.ssim, w.multilevel, base, edge, float(self.inside), float(self.photo.edge_area))
        masks = (self.ids, self.photo.elements, self.sums, photo.area, photo.shares)
        pooled = (self.levels.packed, *masks, tuple(map(float, factors)))
        self.launcher.launch("loss_slopes", 1, *pooled, slopes, similarity)
        return slopes, similarity, -w.ssim * edge / 3

    def _pixel_weights(self) -> tuple[float, float]:
        """Weight of a labelled pixel by eq. 16 and 17, and what an edge adds to it."""
        extra, w = self.weights.edge - 1.0, self.weights
        total = self.inside + extra * self.photo.edge_area
        return w.plain / self.inside + w.boundary / total, w.boundary * extra / total

    def _normals(self, camera: Intrinsics) -> None:
        y, x = self.photo.origin
        intrinsics = tuple(float(v) for v in (camera.fx, camera.fy, camera.cx - x, camera.cy - y))
        given = (self.on_device.maps, self._maps, intrinsics, self._gradient, self.ids, self.sums)
        self.launcher.launch("loss_normals", self.levels.tiles[0], self.levels.packed, *given)

    def _finish(self, slopes: Tensor | None, edge_slope: float) -> None:
        photo, w, (base, edge) = self.on_device, self.weights, self._pixel_weights()
        per_pixel = w.multilevel * photo.shares / photo.area[0].clamp_min(1)
        l1 = base + per_pixel
        l1[1 : self.photo.elements + 1] += per_pixel[:1]
        l1[:1].zero_()  # l1[0] = 0.0 would copy a number from the host, and wait for it
        l1 = (w.l1 / 3 * l1).to(torch.float32)
        rates = (w.l1 * edge / 3, w.background / max(self.photo.band_area, 1), w.distortion / self.inside, w.normals)
        factors = tuple(map(float, (*self.backdrop, *rates)))
        images = (photo.maps, self._maps, self.ids, (slopes, float(edge_slope)), l1, factors, self.scratch)
        goals = (self._gradient, At(self.error, 0), self.error.stride(0), self.sums)
        self.launcher.launch("loss_finish", self.levels.tiles[0], self.levels.packed, *images, *goals)
