# SPDX-License-Identifier: GPL-3.0-or-later
"""Launch the CUDA kernels in order (project, sort, bin, blend, and back), as :mod:`mgf_engine.raster.cpu` does in C."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from mgf_engine.native.cuda.launcher import Launcher, blocks
from mgf_engine.raster.camera import TILE, Camera
from mgf_engine.raster.cpu import (
    MAX_ENTRIES,
    PLANES,
    PLANES_BASIC,
    RECORD,
    SUMS,
    OutputGradients,
    Parameters,
    check_entries,
)
from mgf_engine.raster.cuda.tile_list_capacity import TileListCapacity

_RUN = 1024  # items of a block of the sort, csrc/cuda/sort.cu
_DIGITS = 256
_BACKWARD = ("blend_backward_color", "blend_backward_depth", "blend_backward_all")


@dataclass
class TileLists:
    """Projected Gaussians and, for every tile, those that touch it, front to back; all on the device.

    Attributes:
        records: float32 [N, 32], layout in ``csrc/raster/records.h``; rows with ``tile_counts == 0`` are undefined.
        tile_counts: int32 [N], number of listed tiles each Gaussian touches; 0 where it is not drawn.
        gid: int32 [capacity], Gaussian of every list entry; tile t's list is ``gid[ranges[t]:ranges[t + 1]]``.
        slots: int32 [capacity], place of every entry in the order by Gaussian.
        slot_starts: int32 [N], first slot of each Gaussian.
        ranges: int32 [tiles_x * tiles_y + 1].
        hits: uint8 [capacity], per slot the warps of the tile in which the entry was blended.
        tiles_x, tiles_y: tiles of 16 x 16 pixels; tile t is at column t % tiles_x, row t // tiles_x.
        camera: the packed camera.
    """

    records: Tensor
    tile_counts: Tensor
    gid: Tensor
    slots: Tensor
    slot_starts: Tensor
    ranges: Tensor
    hits: Tensor
    tiles_x: int
    tiles_y: int
    camera: bytes

    @property
    def tiles(self) -> int:
        return self.tiles_x * self.tiles_y

    @property
    def packed(self) -> tuple[Tensor | int, ...]:
        """struct Lists of ``csrc/cuda/blend.cuh``."""
        return (self.records, self.gid, self.slots, self.ranges, self.tiles_x, self.tiles)


@dataclass
class Projection:
    """Projected Gaussians before they are listed; ``records``, tiles and camera as in :class:`TileLists`.

    Attributes:
        footprints: int32 [N, 8], tiles that each Gaussian touches, struct Footprint of ``csrc/raster/footprint.h``.
        tile_counts: int32 [N], their number among the wanted tiles.
        depth_keys: int32 [N], depth as an unsigned integer that sorts alike.
        mask: uint8 [tiles_y, tiles_x], tiles that are wanted; None for all.
    """

    records: Tensor
    footprints: Tensor
    tile_counts: Tensor
    depth_keys: Tensor
    mask: Tensor | None
    tiles_x: int
    tiles_y: int
    camera: bytes


class Rasterizer:
    """The rasterizer on one launcher's device.

    Attributes:
        launcher: starts the kernels.
        capacity: predicts the length of the lists, for renderings that do not wait for it.
    """

    def __init__(self, launcher: Launcher) -> None:
        self.launcher, self.capacity = launcher, TileListCapacity()

    def empty(self, dtype: torch.dtype, *shape: int) -> Tensor:
        return torch.empty(shape, dtype=dtype, device=self.launcher.device)

    def list_tiles(
        self, raw: Parameters, camera: Camera, sh_degree: int, tile_mask: Tensor | None, wait: bool = True
    ) -> TileLists:
        """Project Gaussians and list them per tile.

        Args:
            raw: parameters of the Gaussians, ready for the kernels.
            camera: of the picture.
            sh_degree: of the colours.
            tile_mask: bool [tiles_y, tiles_x], tiles that are wanted; None for all.
            wait: for the number of entries, so that the lists have just the capacity they need.
        """
        return self.bin_tiles(self.project(raw, camera, sh_degree, tile_mask), wait)

    def project(self, raw: Parameters, camera: Camera, sh_degree: int, tile_mask: Tensor | None) -> Projection:
        """Project all Gaussians: records, exact footprints and depths.

        Args:
            raw: parameters of the Gaussians, ready for the kernels.
            camera: of the picture.
            sh_degree: of the colours.
            tile_mask: bool [tiles_y, tiles_x], tiles that are wanted; None for all.
        """
        n, packed = len(raw.positions), camera.packed().numpy().tobytes()
        tiles_y, tiles_x = camera.tiles
        mask = (
            None
            if tile_mask is None
            else tile_mask.to(self.launcher.device, torch.uint8, non_blocking=True).contiguous()
        )
        mask_sums = self.empty(torch.int32, tiles_y, tiles_x + 1)
        self.launcher.launch("mask_rows", blocks(tiles_y), tiles_x, tiles_y, mask, mask_sums)
        records, footprints = self.empty(torch.float32, n, RECORD), self.empty(torch.int32, n, 8)
        tile_counts, keys = self.empty(torch.int32, n), self.empty(torch.int32, n)
        outputs = (records, footprints, tile_counts, keys)
        given = (n, packed, *raw.all, sh_degree, tiles_x, tiles_y, mask_sums)
        self.launcher.launch("project", blocks(n), *given, *outputs)
        return Projection(*outputs, mask, tiles_x, tiles_y, packed)

    def sort(
        self, keys: Tensor, values: Tensor | None, bits: int, listed: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Sort keys and values by the lowest ``bits`` of the keys, stably.

        Args:
            keys: int32 [n], read as unsigned.
            values: int32 [n]; None: 0..n - 1.
            bits: how many of the lowest bits of the keys differ.
            listed: int32 [1] on the device, how many items there are; None: n. Rows beyond are undefined.
        """
        n, runs = len(keys), blocks(len(keys), _RUN)
        counts, totals = self.empty(torch.int32, _DIGITS, runs), self.empty(torch.int32, _DIGITS)
        spare = [(self.empty(torch.int32, n), self.empty(torch.int32, n)) for _ in range(2)]
        for number, shift in enumerate(range(0, bits, 8)):
            to_keys, to_values = spare[number % 2]
            self.launcher.launch("radix_count", runs, n, listed, runs, keys, shift, counts)
            self.launcher.launch("radix_rows", _DIGITS, runs, counts, totals)
            given = (n, listed, runs, keys, values, shift, counts, totals)
            self.launcher.launch("radix_scatter", runs, *given, to_keys, to_values)
            keys, values = to_keys, to_values
        assert values is not None
        return keys, values

    def bin_tiles(self, seen: Projection, wait: bool = True) -> TileLists:
        """Return the lists of all tiles, front to back."""
        n, tiles = len(seen.records), seen.tiles_x * seen.tiles_y
        _, order = self.sort(seen.depth_keys, None, 32)
        sums, total = self.empty(torch.int32, blocks(n)), self.empty(torch.int32, 2)
        self.launcher.launch("list_sums", blocks(n), n, order, seen.tile_counts, sums)
        capacity = 0 if wait else self.capacity.take(n, tiles)
        self.launcher.launch("list_offsets", 1, blocks(n), capacity or MAX_ENTRIES, sums, total)
        if capacity:
            self.capacity.learn_later(self.launcher.read_later(total), capacity, n, tiles)
        else:
            capacity = int(total[0])  # waits
            check_entries(capacity)
            if not wait:  # what is rendered between iterations shall not change them
                self.capacity.learn(capacity, n, tiles)
        slot_starts, ranges = self.empty(torch.int32, n), self.empty(torch.int32, tiles + 1)
        slot_tiles, slot_gid, gid = (self.empty(torch.int32, capacity) for _ in range(3))
        hits = self.empty(torch.uint8, capacity)
        fill = (n, order, seen.footprints, seen.mask, seen.tiles_x, seen.tiles_y, sums, total)
        outputs = (seen.tile_counts, slot_starts, slot_tiles, slot_gid, hits)
        self.launcher.launch("list_fill", blocks(n), *fill, *outputs)
        # Tiles are numbered up to `tiles`, which stands for slots that are left over (lists.cu).
        sorted_tiles, slots = self.sort(slot_tiles, None, tiles.bit_length(), total[1:])
        given = (capacity, tiles, total, sorted_tiles, slots, slot_gid)
        self.launcher.launch("list_ranges", blocks(capacity + 1), *given, ranges, gid)
        found = (seen.records, seen.tile_counts, gid, slots, slot_starts, ranges, hits)
        return TileLists(*found, seen.tiles_x, seen.tiles_y, seen.camera)

    def blend(self, lists: TileLists, geometry: bool) -> tuple[Tensor, Tensor]:
        """Blend the lists; returns the image planes float32 [12 or 5, tiles_y * 16, tiles_x * 16] and the hits."""
        planes = PLANES if geometry else PLANES_BASIC
        image = self.empty(torch.float32, planes, lists.tiles_y * TILE, lists.tiles_x * TILE)
        name = "blend_all" if geometry else "blend_basic"
        self.launcher.launch(name, lists.tiles, lists.packed, lists.camera, image, lists.hits)
        return image, lists.hits

    def backward(
        self,
        raw: Parameters,
        sh_degree: int,
        lists: TileLists,
        image: Tensor,
        hits: Tensor,
        gradients: OutputGradients,
        error_map: Tensor | None,
        statistics: tuple[Tensor, ...] | None,
    ) -> tuple[Tensor, ...]:
        """Return gradients of positions, log_scales, rotations, opacity_logits and sh; see
        :func:`mgf_engine.raster.cpu.backward`.

        Args:
            raw: parameters of the Gaussians, ready for the kernels.
            sh_degree: of the colours.
            lists: what each tile was drawn from.
            image: as :meth:`blend` returned it.
            hits: as :meth:`blend` returned them.
            gradients: of the loss by each output.
            error_map: float32 [H, W], per-pixel error that statistics gather; None for zero.
            statistics: to add to, or none.
        """
        sums = self.blend_backward(lists, image, hits, gradients, error_map, statistics is not None)
        return self.project_backward(raw, sh_degree, lists, hits, sums, gradients.level, statistics)

    def blend_backward(
        self,
        lists: TileLists,
        image: Tensor,
        hits: Tensor,
        gradients: OutputGradients,
        error_map: Tensor | None,
        stats: bool,
    ) -> Tensor:
        """Return sums over each tile's pixels per slot, float32 [capacity, 24] (``csrc/raster/blend_backward.h``).

        Args:
            lists: what each tile was drawn from.
            image: as :meth:`blend` returned it.
            hits: as :meth:`blend` returned them.
            gradients: of the loss by each output.
            error_map: float32 [H, W], per-pixel error that statistics gather; None for zero.
            stats: whether sums for the statistics are needed, too.
        """
        sums = self.empty(torch.float32, len(hits), SUMS)
        g = gradients
        given = (g.color, g.alpha, g.depth, g.median, g.normal, g.distortion, error_map)
        name = _BACKWARD[gradients.level] + ("_stats" if stats else "")
        self.launcher.launch(name, lists.tiles, lists.packed, lists.camera, image, hits, given, sums)
        return sums

    def project_backward(
        self,
        raw: Parameters,
        sh_degree: int,
        lists: TileLists,
        hits: Tensor,
        sums: Tensor,
        level: int,
        statistics: tuple[Tensor, ...] | None,
    ) -> tuple[Tensor, ...]:
        """Return gradients of the raw parameters from the sums of all list entries; adds to the statistics.

        Args:
            raw: parameters of the Gaussians, ready for the kernels.
            sh_degree: of the colours.
            lists: what each tile was drawn from.
            hits: as :meth:`blend` returned them.
            sums: of :meth:`blend_backward`.
            level: which outputs have gradients: colour, depth as well, or all.
            statistics: to add to, or none.
        """
        n = len(raw.positions)
        gradients = tuple(torch.empty_like(t) for t in raw.all[:5])
        columns = SUMS if statistics is not None or level > 0 else 16
        entries = (lists.records, lists.tile_counts, lists.slot_starts, hits, sums, columns)
        given = (n, lists.camera, *raw.all, sh_degree, *entries)
        self.launcher.launch("project_backward", blocks(n), *given, gradients, statistics or (None,) * 6)
        return gradients
