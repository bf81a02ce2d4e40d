# SPDX-License-Identifier: GPL-3.0-or-later
"""Opacity of points in space on a GPU: the counterpart of the kernels behind :mod:`mgf_engine.raster.points`."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mgf_engine.model.scene import View
from mgf_engine.native.cuda.launcher import blocks
from mgf_engine.raster.camera import TILE, Camera, pose_and_intrinsics
from mgf_engine.raster.cpu import Parameters
from mgf_engine.raster.cuda.blending import Projection, Rasterizer

_INNERS = 16  # blocks of 4 x 4 pixels in a tile, csrc/cuda/points.cu


class DevicePoints:
    """Evaluates on a GPU how opaque a field is in front of points, seen from a view.

    Args:
        rasterizer: of the device.
        raw: the field's parameters there.
        reach: float64 [n], standard deviations at which each Gaussian fades to 1/255.
        spread: float64 [n, 3, 3], axes times standard deviations, column k is axis k.
    """

    def __init__(self, rasterizer: Rasterizer, raw: Parameters, reach: Tensor, spread: Tensor) -> None:
        self._rasterizer, self._launcher, self._raw = rasterizer, rasterizer.launcher, raw
        self._reach, self._spread = self._upload(reach), self._upload(spread)

    def lower(
        self,
        lowest: NDArray[np.float32],
        points: NDArray[np.float32],
        view: View,
        mask: NDArray[np.uint8],
        near: float,
        stop: float,
    ) -> NDArray[np.uint8]:
        """Do as :meth:`mgf_engine.raster.points.PointOpacity.lower`.

        Args:
            lowest: float32 [N, 2], the two smallest opacities found so far; changed in place.
            points: float32 [N, 3], normalised frame.
            view: camera of the photo.
            mask: uint8 [H, W], as these kernels read it.
            near: depth in front of which nothing counts.
            stop: transmittance at which the exact value no longer matters.
        """
        n, tiles = len(points), -(-view.width // TILE) * -(-view.height // TILE)
        place, visibility, keys = self._locate(points, view, mask, near)
        sorted_keys, order = self._rasterizer.sort(keys, None, (tiles * _INNERS).bit_length())
        starts, wanted = self._empty(torch.int32, tiles + 1), self._empty(torch.uint8, tiles)
        self._launcher.launch("points_starts", blocks(n + 1), n, tiles, sorted_keys, starts)
        self._launcher.launch("points_tiles", blocks(tiles), tiles, starts, wanted)
        lists = self._rasterizer.bin_tiles(self._grown(view, wanted))
        low = self._upload(torch.from_numpy(lowest))
        given = (lists.packed, self._front(view), place, order, starts, float(near), float(stop), low)
        self._launcher.launch("points_opacity", tiles, *given)
        lowest[:] = low.cpu().numpy()
        found: NDArray[np.uint8] = visibility.cpu().numpy()
        return found

    def _locate(
        self, points: NDArray[np.float32], view: View, mask: NDArray[np.uint8], near: float
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return place, visibility and sort key of every point."""
        n = len(points)
        pose = np.concatenate(pose_and_intrinsics(view)).tobytes()
        place, visibility = self._empty(torch.float32, n, 3), self._empty(torch.uint8, n)
        keys, labels = self._empty(torch.int32, n), self._upload(torch.from_numpy(np.ascontiguousarray(mask)))
        given = (n, self._upload(torch.from_numpy(points)), pose, float(near), labels, view.height, view.width)
        self._launcher.launch("points_locate", blocks(n), *given, place, visibility, keys)
        return place, visibility, keys

    def _grown(self, view: View, wanted: Tensor) -> Projection:
        """Return the field as the view sees it, with footprints grown to points between pixel centres."""
        seen = self._rasterizer.project(self._raw, Camera.from_view(view), 0, None)
        sums = self._empty(torch.int32, seen.tiles_y, seen.tiles_x + 1)
        self._launcher.launch("mask_rows", blocks(seen.tiles_y), seen.tiles_x, seen.tiles_y, wanted, sums)
        given = (len(seen.records), seen.records, seen.tiles_x, seen.tiles_y, sums)
        outputs = (seen.footprints, seen.tile_counts, seen.depth_keys)
        self._launcher.launch("points_grow", blocks(len(seen.records)), *given, *outputs)
        seen.mask = wanted
        return seen

    def _front(self, view: View) -> Tensor:
        """Return depth [n] before which each Gaussian contributes less than 1/255."""
        axis = self._upload(torch.from_numpy(view.rotation[2].astype(np.float64)))
        depth = self._raw.positions.double() @ axis + float(view.translation[2])
        deviation = torch.einsum("nik,i->nk", self._spread, axis).norm(dim=1)
        return (depth - 1.001 * self._reach * deviation - 1e-6).to(torch.float32).contiguous()

    def _upload(self, tensor: Tensor) -> Tensor:
        return tensor.to(self._launcher.device).contiguous()

    def _empty(self, dtype: torch.dtype, *shape: int) -> Tensor:
        return torch.empty(shape, dtype=dtype, device=self._launcher.device)
