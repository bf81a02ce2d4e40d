# SPDX-License-Identifier: GPL-3.0-or-later
"""The terms of the training loss (eq. 16-20) and their gradients in one go, by the kernels ``loss*.c``.

Value and gradients are made together in the forward pass; the backward pass only hands them over. Sums are added per
tile and then over tiles in a fixed order, so nothing depends on the number of threads. The reference in plain torch is
:func:`mgf_engine.field.reference_losses.total_loss`.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mgf_engine.native.buffers import RenderBuffers, lasting_array
from mgf_engine.native.library import parallel
from mgf_engine.raster.api import Rendering
from mgf_engine.raster.camera import Intrinsics
from mgf_engine.raster.device import backend_for
from mgf_engine.raster.loss_inputs import LossPhoto, LossWeights
from mgf_engine.raster.loss_photo import TILE_H
from mgf_engine.raster.map_gradients import ALPHA, DEPTH, NORMAL, count_planes, split_planes
from mgf_engine.raster.ms_ssim import ms_ssim


@dataclass(frozen=True)
class Terms:
    """The total (scalar, differentiable) and its parts, already weighted: scalars on a GPU, elsewhere floats."""

    total: Tensor
    color: Tensor | float
    geometry: Tensor | float
    background: Tensor | float


def image_loss(
    rendering: Rendering,
    photo: LossPhoto,
    weights: LossWeights,
    backdrop: Tensor,
    camera: Intrinsics,
    error: Tensor,
    backend: str | None = None,
) -> Terms:
    """Compare a rendering with a photo; differentiable in colour, alpha, depth, normal and distortion.

    Args:
        rendering: maps of the whole frame; depth, normal and distortion only count where their factor is not zero.
        photo: photo and labels, prepared once (:func:`mgf_engine.raster.loss_photo.prepare_photo`).
        weights: of the terms.
        backdrop: float32 [3] on the CPU, colour behind the field inside the mask.
        camera: intrinsics of the whole frame.
        error: float32 [h, w], rows may be apart; receives the absolute colour error inside the box plus alpha on the
            background band.
        backend: ``cpu``, ``cuda`` or ``cuda-source-on-cpu``. None: ``cuda`` for maps on a GPU, else ``cpu``.

    Raises:
        ValueError: the backend cannot read the maps' kind of memory.
    """
    backend = backend_for(rendering.color, backend)
    maps = [rendering.color, rendering.alpha]
    if weights.distortion > 0:
        maps.append(_needed(rendering.distortion))
    if weights.normals > 0:
        maps += [rendering.depth, _needed(rendering.normal)]
    if any((m.device.type == "cuda") != (backend == "cuda") for m in (*maps, error)):
        raise ValueError(f"the loss kernels of {backend} cannot read maps on {rendering.color.device}")
    parts: dict[str, Tensor | float] = {}
    total = _ImageLoss.apply(backend, photo, weights, backdrop, camera, error, parts, *maps)  # type: ignore[no-untyped-call]
    return Terms(total, **parts)


def _needed(map: Tensor | None) -> Tensor:
    if map is None:
        raise ValueError("the geometry terms need a rendering with all outputs")
    return map


class _ImageLoss(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *arguments: Any) -> Tensor:
        backend, photo, weights, backdrop, camera, error, parts, *maps = arguments
        if backend != "cpu":
            from mgf_engine.raster.cuda import launcher_on
            from mgf_engine.raster.cuda.loss import DevicePass

            compared = DevicePass(launcher_on(backend), photo, weights, backdrop, error, _aligned(maps))
            total, terms = compared.run(camera)
            parts.update(zip(("color", "geometry", "background"), terms.unbind(), strict=True))
            ctx.gradients = compared.gradients()
            return total
        work = _Pass(photo, weights, backdrop, error, _aligned(maps))
        parts.update(work.run(camera))
        ctx.gradients = work.gradients()
        return torch.tensor(sum(parts.values()), dtype=torch.float32)

    @staticmethod
    def backward(ctx: Any, *slopes: Tensor) -> tuple[Tensor | None, ...]:
        slope = slopes[0] if slopes[0].is_cuda else float(slopes[0])  # to read it would be to wait for the GPU
        scaled = (g if isinstance(slope, float) and slope == 1.0 else g * slope for g in ctx.gradients)
        return (*(None,) * 7, *scaled)


def _aligned(maps: list[Tensor]) -> list[Tensor]:
    """Return the maps as the kernels take them: float32, and rows equally far apart in all of them."""
    maps = [m.detach().to(torch.float32) for m in maps]
    if len({m.stride(-2) for m in maps}) == 1 and all(m.stride(-1) == 1 for m in maps):
        return maps
    return [m.contiguous() for m in maps]


class _Pass:
    """One comparison: scratch memory, gradients, and the kernels in order."""

    def __init__(
        self, photo: LossPhoto, weights: LossWeights, backdrop: Tensor, error: Tensor, maps: list[Tensor]
    ) -> None:
        self.photo, self.weights, self.error = photo, weights, error
        self.backdrop = backdrop.to(torch.float32).contiguous()
        self.color, self.alpha, *others = maps
        self.distortion = others.pop(0) if weights.distortion > 0 else None
        self.depth: Tensor | None = others[0] if weights.normals > 0 else None
        self.normal: Tensor | None = others[1] if weights.normals > 0 else None
        self.buffers = RenderBuffers()
        self.scratch = self.buffers.array(torch.float32, photo.scratch)
        self.gradient = lasting_array(torch.float32, count_planes(weights), *self.alpha.shape)
        self.scales = len(photo.levels) if weights.multilevel > 0 else 1
        tiles = photo.levels[: self.scales, 2] * photo.levels[: self.scales, 3]
        self.finest, self.tiles = int(tiles[0]), int(tiles.sum())
        self.ids = photo.area.shape[1]
        self.inside = max(int(photo.area[0, 1:].sum()), 1)
        self.failed = np.zeros(1, np.int32)

    def run(self, camera: Intrinsics) -> dict[str, float]:
        """Return the parts of the loss; :meth:`gradients` has theirs then."""
        photo, scratch = self.photo, self.scratch
        levels = (photo.levels, self.scales)
        color = self._at_box(self.color), self.color.stride(0), self.color.stride(1)
        alpha = self._at_box(self.alpha), self.alpha.stride(0)
        given = (*color, *alpha, photo.image, photo.labels, self.backdrop, scratch)
        parallel("mgf_loss_prepare", *levels, *given, pieces=self.finest)
        similarity, slopes, edge_slope = self._similarity() if self.weights.ssim > 0 else (0.0, None, 0.0)
        if slopes is not None and self.scales > 1:
            coarse = (photo.flags, photo.labels, self.ids, slopes, scratch)
            parallel("mgf_loss_coarse", *levels, *coarse, self.failed, pieces=self.tiles - self.finest)
        consistency, normals = self._normals(camera) if self.depth is not None else (0.0, 0.0)
        l1, in_band, distortion = self._finish(slopes, edge_slope, normals)
        if self.failed[0]:
            raise MemoryError("Not enough memory to compare the render with the photo; work at a lower resolution.")
        return {
            "color": similarity + l1,
            "geometry": consistency + self.weights.distortion * distortion / self.inside,
            "background": self.weights.background * in_band / max(photo.band_area, 1),
        }

    def gradients(self) -> list[Tensor]:
        """Return the gradients of the maps, in the order they came."""
        return split_planes(self.gradient, self.weights)

    def _at_box(self, map: Tensor | None) -> Any:
        """Return the address of a map's first pixel in the box."""
        if map is None:
            return None
        y, x = self.photo.origin
        return ctypes.c_void_p(map.data_ptr() + 4 * (y * map.stride(-2) + x))

    def _pixel_weights(self) -> tuple[float, float, float]:
        """Weight of a labelled pixel by eq. 16 and 17, what an edge adds to it, and the sum of the latter."""
        extra, w = self.weights.edge - 1.0, self.weights
        total = self.inside + extra * self.photo.edge_area
        edge = w.boundary * extra / total
        return w.plain / self.inside + w.boundary / total, edge, edge * self.photo.edge_area

    def _similarity(self) -> tuple[float, NDArray[np.float32], float]:
        """Return the SSIM terms, their slopes by label [scales, 2, ids] and the extra slope of an edge."""
        photo, ids, weights = self.photo, self.ids, self.weights
        sums = np.zeros((len(photo.flags), 2 * ids + 1))
        given = (photo.flags, photo.labels, photo.edges, ids, self.scratch, sums)
        parallel("mgf_loss_forward", photo.levels, self.scales, *given, self.failed, pieces=self.tiles)
        ends = [*photo.levels[1 : self.scales, 4], len(sums)]
        pooled = np.stack([part.sum(0) for part in np.split(sums, ends[:-1])])[: self.scales] / 3
        base, edge, edges = self._pixel_weights()
        loss = weights.ssim * (base * (self.inside - pooled[0, 1:ids].sum()) + edges - edge * pooled[0, 2 * ids])
        slopes = np.zeros((self.scales, 2, ids))
        if weights.multilevel > 0:
            of_masks = pooled[:, : 2 * ids].reshape(-1, 2, ids).copy()
            own = slice(1, photo.elements + 1)
            of_masks[..., 0] = of_masks[..., own].sum(-1)
            value, slopes = ms_ssim(of_masks, photo.area)
            share = weights.multilevel * weights.ssim * weights.labels
            loss += float((share * (1.0 - value)).sum())
            slopes *= -share
            slopes[..., own] += slopes[..., :1]  # every pixel of an element is one of the whole building, too
            slopes[..., 0] = 0.0
        slopes[0, 0, 1:] -= weights.ssim * base
        return float(loss), (slopes / 3).astype(np.float32), -weights.ssim * edge / 3

    def _normals(self, camera: Intrinsics) -> tuple[float, float]:
        """Return the normal term, and the factor its gradients still need."""
        assert self.depth is not None and self.normal is not None
        photo, sums, (y, x) = self.photo, np.zeros((len(self.photo.strips), 2)), self.photo.origin
        height, width = photo.labels.shape
        if min(height, width) < 3:
            self.gradient[DEPTH:].zero_()
            self.gradient[ALPHA].zero_()
            return 0.0, 0.0
        intrinsics = (float(camera.fx), float(camera.fy), float(camera.cx - x), float(camera.cy - y))
        images = (self._at_box(self.depth), self._at_box(self.normal), self._at_box(self.alpha))
        goals = [self._at_box(self.gradient[plane]) for plane in (DEPTH, NORMAL, ALPHA)]
        parallel(
            "mgf_loss_normals", *images, self.normal.stride(0), self.normal.stride(1), photo.labels, photo.strips,
            height, width, *intrinsics, sums, *goals, self.gradient.stride(1), self.gradient.stride(0), self.failed,
            pieces=len(photo.strips),
        )  # fmt: skip
        loss, total = sums.sum(0)
        factor = self.weights.normals / total if total > 0 else 0.0
        return float(loss * factor), float(factor)

    def _finish(self, slopes: NDArray[np.float32] | None, edge_slope: float, normals: float) -> NDArray[np.float64]:
        """Compute all gradients; returns sums: the L1 terms, alpha over the background band, distortion inside."""
        photo, weights, (y, x) = self.photo, self.weights, self.photo.origin
        base, edge, _ = self._pixel_weights()
        l1 = np.zeros(self.ids)
        per_pixel = weights.multilevel * weights.labels / np.maximum(photo.area[0], 1)
        l1[1:] = base + per_pixel[1:]
        l1[1 : photo.elements + 1] += per_pixel[0]
        l1 = (weights.l1 * l1 / 3).astype(np.float32)
        addresses = [
            self._at_box(self.alpha), self._at_box(self.distortion), self._at_box(self.depth), photo.labels,
            photo.edges, photo.background_band, slopes, l1, self.gradient, self.error,
        ]  # fmt: skip
        sizes = (self.alpha.stride(0), self.error.stride(0), *self.alpha.shape, y, x, len(self.gradient))
        finish = np.array([*map(_address, addresses), *sizes], np.int64)
        factors = np.array([
            *self.backdrop.tolist(), edge_slope, weights.l1 * edge / 3, weights.background / max(photo.band_area, 1),
            weights.distortion / self.inside, normals,
        ], np.float32)  # fmt: skip
        sums = np.zeros((self.finest, 3))
        given = (photo.flags, self.ids, finish, factors, self.scratch, sums)
        bands = -(-self.alpha.shape[0] // TILE_H)
        parallel("mgf_loss_finish", photo.levels, self.scales, *given, self.failed, pieces=self.finest + bands)
        total: NDArray[np.float64] = sums.sum(0)
        return total


def _address(value: Any) -> int:
    if isinstance(value, Tensor):
        return value.data_ptr()
    if isinstance(value, np.ndarray):
        return value.ctypes.data
    return (value.value or 0) if value is not None else 0
