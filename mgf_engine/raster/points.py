# SPDX-License-Identifier: GPL-3.0-or-later
"""Opacity of points in space as a camera sees them (eq. 23-24), by the kernels in ``csrc/raster/points.c``.

The reference in float64 is :func:`mgf_engine.raster.reference_points.opacity_of_points`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mgf_engine.model.gaussians import Gaussians, rotation_matrices
from mgf_engine.model.scene import View
from mgf_engine.native.library import call, parallel
from mgf_engine.raster.camera import TILE, Camera, pose_and_intrinsics
from mgf_engine.raster.cpu import Parameters, TileLists, bin_tiles, project
from mgf_engine.raster.device import backend_for

if TYPE_CHECKING:
    from mgf_engine.raster.cuda.points import DevicePoints

OUTSIDE, INSIDE, IGNORE = 0, 1, 2  # of a mask as these kernels read it
BACKGROUND, SEEN, UNSEEN = 0, 1, 2  # visibility of a point in a view
NEAR = Camera.near  # nothing nearer to the camera counts, normalised frame

BLOCKS = 16  # blocks of 4 x 4 pixels in a tile


@dataclass(frozen=True)
class Located:
    """Where points fall in a view.

    Attributes:
        place: float32 [N, 3], (u, v, depth); undefined for points not SEEN.
        visibility: uint8 [N], SEEN (on INSIDE), BACKGROUND (on OUTSIDE) or UNSEEN (out of frame, behind, on IGNORE).
        block: int32 [N], tile * 16 + block of 4 x 4 pixels in the tile; -1 for points not SEEN.
    """

    place: NDArray[np.float32]
    visibility: NDArray[np.uint8]
    block: NDArray[np.int32]


def locate(points: NDArray[np.float32], view: View, mask: NDArray[np.uint8]) -> Located:
    """Project points [N, 3] (normalised frame) into a view with a mask [H, W] of OUTSIDE, INSIDE and IGNORE."""
    _check_mask(view, mask)
    count = len(points)
    found = Located(np.empty((count, 3), np.float32), np.empty(count, np.uint8), np.empty(count, np.int32))
    camera = (*pose_and_intrinsics(view), NEAR, mask, view.height, view.width)
    parallel("mgf_locate_points", count, points, *camera, found.place, found.visibility, found.block)
    return found


def _check_mask(view: View, mask: NDArray[np.uint8]) -> None:
    if mask.shape != (view.height, view.width):
        raise ValueError(f"the mask is {mask.shape}, the view {(view.height, view.width)}")


class PointOpacity:
    """Evaluates how opaque a field is in front of points, seen from a view.

    Args:
        gaussians: the field, normalised frame.
        backend: ``cpu``, ``cuda`` or ``cuda-source-on-cpu``. None: ``cuda`` for Gaussians on a GPU, else ``cpu``.
    """

    def __init__(self, gaussians: Gaussians, backend: str | None = None) -> None:
        self._parameters = Parameters.of_field(gaussians)
        with torch.no_grad():
            opacity = gaussians.opacities.clamp_min(1 / 255)
            reach = torch.sqrt(2 * torch.log(255 * opacity)).double()
            self._deviations = deviations(gaussians)
        self._reach: NDArray[np.float64] = reach.cpu().numpy()
        self._centres: NDArray[np.float64] = gaussians.positions.detach().double().cpu().numpy()
        self._device: DevicePoints | None = None
        backend = backend_for(gaussians.positions, backend)
        if backend != "cpu":
            from mgf_engine.raster.cuda import rasterizer_on
            from mgf_engine.raster.cuda.points import DevicePoints

            rasterizer = rasterizer_on(backend)
            self._device = DevicePoints(rasterizer, self._parameters, reach, torch.from_numpy(self._deviations))

    def lower(
        self,
        lowest: NDArray[np.float32],
        points: NDArray[np.float32],
        view: View,
        mask: NDArray[np.uint8],
        stop: float = 1e-4,
    ) -> NDArray[np.uint8]:
        """Let one view lower the opacity of points.

        Args:
            lowest: float32 [N, 2], the two smallest opacities found so far (start with ones or more); changed in place.
                Where the kernel stopped early, a value is only known to be at least ``1 - stop``.
            points: float32 [N, 3], normalised frame.
            view: the camera.
            mask: uint8 [H, W], OUTSIDE, INSIDE or IGNORE; only points that fall on INSIDE are asked for.
            stop: transmittance at which the exact value no longer matters.

        Returns:
            uint8 [N], the visibility of :class:`Located`; points SEEN were asked for.

        Raises:
            MemoryError: the work needs more than is free.
        """
        if self._device is not None:
            _check_mask(view, mask)
            return self._device.lower(lowest, points, view, mask, NEAR, stop)
        where = locate(points, view, mask)
        tiles_x, tiles_y = -(-view.width // TILE), -(-view.height // TILE)
        tiles = tiles_x * tiles_y
        order, starts = np.empty(len(points), np.int32), np.empty(tiles * BLOCKS + 1, np.int32)
        call("mgf_sort_points", len(points), where.block, tiles * BLOCKS, order, starts)
        listed = np.diff(starts[::BLOCKS]) > 0
        if listed.any():
            lists = self._tile_lists(view, torch.from_numpy(listed.reshape(tiles_y, tiles_x)))
            failed = np.zeros(1, np.int32)
            tile_lists = (lists.records, lists.gid, lists.ranges, self._front(view))
            parallel(
                "mgf_point_opacity", tiles, *tile_lists, where.place, order, starts, NEAR, float(stop), lowest, failed
            )
            if failed[0]:
                raise MemoryError("Not enough memory for the opacity of points; use fewer Gaussians.")
        return where.visibility

    def _front(self, view: View) -> NDArray[np.float32]:
        """Return depth [n] before which each Gaussian contributes less than 1/255."""
        axis = view.rotation[2]
        depth = self._centres @ axis + view.translation[2]
        deviation = np.linalg.norm(np.einsum("nik,i->nk", self._deviations, axis), axis=1)
        return (depth - 1.001 * self._reach * deviation - 1e-6).astype(np.float32)

    def _tile_lists(self, view: View, listed: Tensor) -> TileLists:
        """Return, for each of the ``listed`` tiles [tiles_y, tiles_x], the Gaussians that may cover a point in it."""
        seen = project(self._parameters, Camera.from_view(view), 0, None)
        call("mgf_grow_footprints", len(seen.records), seen.records, seen.footprints)
        return bin_tiles(replace(seen, mask=listed.to(torch.uint8)))


def deviations(gaussians: Gaussians) -> NDArray[np.float64]:
    """Return the axes of the Gaussians times their standard deviations (3D filter included), [n, 3, 3]; column k is
    axis k."""
    axes = rotation_matrices(gaussians.rotations.detach().double())
    return (axes * gaussians.scales.double()[:, None, :]).cpu().numpy()
