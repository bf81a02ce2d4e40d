# SPDX-License-Identifier: GPL-3.0-or-later
"""The CPU backend: call the C kernels in order (project, sort, bin, blend, and back)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from mgf_engine.errors import BadInput
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.native.buffers import RenderBuffers
from mgf_engine.native.library import call, parallel
from mgf_engine.raster.camera import TILE, Camera

RECORD = 32  # floats per record, csrc/raster/records.h
PLANES, PLANES_BASIC = 12, 5  # image planes, csrc/raster/blend.h
SUMS = 24  # gradient sums per list entry, csrc/raster/blend_backward.h
MAX_ENTRIES = 2**31 - 2  # of all tile lists together: they are numbered by int32
_CHUNKS = 16  # parts of the depth order that are binned side by side
_LEVEL_COLOR, _LEVEL_DEPTH, _LEVEL_ALL = 0, 1, 2


@dataclass
class TileLists:
    """Projected Gaussians and, for every tile, those that touch it, front to back.

    Attributes:
        records: float32 [N, 32], layout in ``csrc/raster/records.h``; rows with ``tile_counts == 0`` are undefined.
        tile_counts: int32 [N], number of listed tiles each Gaussian touches; 0 where it is not drawn.
        gid: int32 [E], Gaussian of every list entry; tile t's list is ``gid[ranges[t]:ranges[t + 1]]``.
        slots: int32 [E], place of every entry in the order by Gaussian.
        slot_starts: int64 [N + 1], first slot of each Gaussian.
        ranges: int32 [tiles_x * tiles_y + 1].
        tiles_x, tiles_y: tiles of 16 x 16 pixels; tile t is at column t % tiles_x, row t // tiles_x.
        camera: the packed camera, float32 [32].
        buffers: owner of the arrays; they are recycled when it is dropped.
    """

    records: Tensor
    tile_counts: Tensor
    gid: Tensor
    slots: Tensor
    slot_starts: Tensor
    ranges: Tensor
    tiles_x: int
    tiles_y: int
    camera: Tensor
    buffers: RenderBuffers

    @property
    def entries(self) -> int:
        return len(self.gid)


@dataclass
class Parameters:
    """The raw parameters as detached contiguous float32 tensors, in the order the kernels take them."""

    positions: Tensor
    log_scales: Tensor
    rotations: Tensor
    opacity_logits: Tensor
    sh: Tensor
    filter_3d: Tensor

    @classmethod
    def of(cls, *tensors: Tensor) -> Parameters:
        return cls(*(t.detach().to(torch.float32).contiguous() for t in tensors))

    @classmethod
    def of_field(cls, gaussians: Gaussians) -> Parameters:
        g = gaussians
        return cls.of(g.positions, g.log_scales, g.rotations, g.opacity_logits, g.sh, g.filter_3d)

    @property
    def all(self) -> tuple[Tensor, ...]:
        return (self.positions, self.log_scales, self.rotations, self.opacity_logits, self.sh, self.filter_3d)


def build_lists(gaussians: Gaussians, camera: Camera, sh_degree: int = 0, tile_mask: Tensor | None = None) -> TileLists:
    """Project Gaussians and list them per tile, without gradients.

    Args:
        gaussians: N Gaussians.
        camera: the camera.
        sh_degree: degree of the colours in the records, 0..3.
        tile_mask: [tiles_y, tiles_x], non-zero where a tile is wanted; none means all.
    """
    return list_tiles(Parameters.of_field(gaussians), camera, sh_degree, tile_mask)


@dataclass
class Projection:
    """Projected Gaussians before they are listed; ``records``, camera and buffers as in :class:`TileLists`.

    Attributes:
        footprints: int32 [N, 8], tiles that each Gaussian touches, struct Footprint of ``csrc/raster/footprint.h``.
        tile_counts: int32 [N], their number among the wanted tiles.
        depth_keys: int32 [N], depth as an unsigned integer that sorts alike.
        mask: uint8 [tiles_y, tiles_x], 1 for tiles that are wanted.
    """

    records: Tensor
    footprints: Tensor
    tile_counts: Tensor
    depth_keys: Tensor
    mask: Tensor
    camera: Tensor
    buffers: RenderBuffers


def list_tiles(
    raw: Parameters, camera: Camera, sh_degree: int, tile_mask: Tensor | None, wait: bool = True
) -> TileLists:
    """List the Gaussians of each tile as :func:`build_lists` does, from parameters that are ready for the kernels.

    Args:
        raw: parameters of the Gaussians, ready for the kernels.
        camera: of the picture.
        sh_degree: of the colours.
        tile_mask: bool [tiles_y, tiles_x], tiles that are wanted; None for all.
        wait: ignored on the CPU; see :class:`mgf_engine.raster.cuda.blending.Rasterizer`.
    """
    return bin_tiles(project(raw, camera, sh_degree, tile_mask))


def project(raw: Parameters, camera: Camera, sh_degree: int, tile_mask: Tensor | None) -> Projection:
    """Project all Gaussians: records, exact footprints and depths.

    Args:
        raw: parameters of the Gaussians, ready for the kernels.
        camera: of the picture.
        sh_degree: of the colours.
        tile_mask: bool [tiles_y, tiles_x], tiles that are wanted; None for all.
    """
    n, buffers, packed = len(raw.positions), RenderBuffers(), camera.packed()
    tiles_y, tiles_x = camera.tiles
    mask = torch.ones(tiles_y, tiles_x, dtype=torch.uint8) if tile_mask is None else (tile_mask != 0).to(torch.uint8)
    mask = mask.contiguous()
    mask_sums = torch.zeros(tiles_y, tiles_x + 1, dtype=torch.int32)
    mask_sums[:, 1:] = mask.cumsum(1)
    records, footprints = buffers.array(torch.float32, n, RECORD), buffers.array(torch.int32, n, 8)
    tile_counts, keys = buffers.array(torch.int32, n), buffers.array(torch.int32, n)
    outputs = (records, footprints, tile_counts, keys)
    parallel("mgf_project", n, packed, *raw.all, sh_degree, tiles_x, tiles_y, mask_sums, *outputs)
    return Projection(*outputs, mask, packed, buffers)


def bin_tiles(seen: Projection) -> TileLists:
    """Return the lists of all tiles in ``seen.mask``, front to back.

    Footprints and mask may have changed since ``seen.tile_counts`` were made; ``slots`` have no meaning then.
    """
    buffers, n = seen.buffers, len(seen.records)
    tiles_y, tiles_x = seen.mask.shape
    order, slot_starts = buffers.array(torch.int32, n), buffers.array(torch.int64, n + 1)
    scratch = buffers.array(torch.int32, 3 * n)
    count = call("mgf_sort", n, seen.depth_keys, seen.tile_counts, order, slot_starts, scratch)
    places, ranges = (
        buffers.array(torch.int32, _CHUNKS, tiles_x * tiles_y),
        buffers.array(torch.int32, tiles_x * tiles_y + 1),
    )
    binning = (_CHUNKS, count, order, seen.footprints, seen.mask, tiles_x, tiles_y, places)
    parallel("mgf_bin_count", *binning)
    entries = int(places.sum())  # not slot_starts[n]: footprints may have grown since their tiles were counted
    check_entries(entries)
    call("mgf_bin_ranges", _CHUNKS, tiles_x * tiles_y, places, ranges)
    gid, slots = buffers.array(torch.int32, entries), buffers.array(torch.int32, entries)
    parallel("mgf_bin_fill", *binning, slot_starts, gid, slots)
    found = (seen.records, seen.tile_counts, gid, slots, slot_starts, ranges)
    return TileLists(*found, tiles_x, tiles_y, seen.camera, buffers)


def check_entries(entries: int) -> None:
    """Check the number of entries of all tile lists.

    Raises:
        BadInput: there are more than :data:`MAX_ENTRIES`.
    """
    if entries > MAX_ENTRIES:
        raise BadInput(
            f"The Gaussians touch {entries:,} tiles, more than the kernels can list; lower --resolution or "
            "--max-gaussians."
        )


def blend(lists: TileLists, geometry: bool) -> tuple[Tensor, Tensor]:
    """Blend the lists.

    Returns:
        the image planes float32 [12 or 5, tiles_y * 16, tiles_x * 16] (``csrc/raster/blend.h``), and per slot the
        blocks in which the entry was blended, int16 [E].
    """
    planes = PLANES if geometry else PLANES_BASIC
    image = torch.empty(planes, lists.tiles_y * TILE, lists.tiles_x * TILE)
    hits = lists.buffers.array(torch.int16, lists.entries)
    tiles = lists.tiles_x * lists.tiles_y
    listed = (lists.records, lists.gid, lists.slots, lists.ranges, lists.tiles_x)
    parallel("mgf_blend", tiles, lists.camera, *listed, int(geometry), image, hits)
    return image, hits


@dataclass
class OutputGradients:
    """Gradients of the outputs, float32 contiguous and as large as the outputs; None where there is none."""

    color: Tensor | None
    alpha: Tensor | None
    depth: Tensor | None
    median: Tensor | None
    normal: Tensor | None
    distortion: Tensor | None

    @property
    def level(self) -> int:
        if self.median is not None or self.normal is not None or self.distortion is not None:
            return _LEVEL_ALL
        return _LEVEL_COLOR if self.depth is None else _LEVEL_DEPTH


def backward(
    raw: Parameters,
    sh_degree: int,
    lists: TileLists,
    image: Tensor,
    hits: Tensor,
    gradients: OutputGradients,
    error_map: Tensor | None,
    statistics: tuple[Tensor, ...] | None,
) -> tuple[Tensor, ...]:
    """Return gradients of positions, log_scales, rotations, opacity_logits and sh.

    Args:
        raw: parameters of the Gaussians, ready for the kernels.
        sh_degree: of the colours.
        lists: what each tile was drawn from.
        image: as :func:`blend` made it.
        hits: as :func:`blend` made them.
        gradients: of the loss by each output.
        error_map: float32 [H, W], error of each pixel that ``statistics`` sum up; None for zero.
        statistics: all of :class:`mgf_engine.raster.outputs.RenderStats`, to add to, or none.
    """
    sums = blend_backward(lists, image, hits, gradients, error_map, statistics is not None)
    return project_backward(raw, sh_degree, lists, hits, sums, gradients.level, statistics)


def blend_backward(
    lists: TileLists, image: Tensor, hits: Tensor, gradients: OutputGradients, error_map: Tensor | None, stats: bool
) -> Tensor:
    """Return sums over each tile's pixels for every list entry, float32 [E, 24] (``csrc/raster/blend_backward.h``).

    Args:
        lists: as :func:`list_tiles` made them.
        image: rendered maps, as :func:`blend` made them.
        hits: as :func:`blend` made them.
        gradients: of the loss with respect to the rendered maps.
        error_map: float32 [H, W], colour error of the pixels for the statistics.
        stats: whether statistics are summed up.
    """
    sums = lists.buffers.array(torch.float32, lists.entries, SUMS)
    listed = (lists.records, lists.gid, lists.slots, lists.ranges, lists.tiles_x)
    g = gradients
    given = (g.color, g.alpha, g.depth, g.median, g.normal, g.distortion, error_map)
    tiles = lists.tiles_x * lists.tiles_y
    parallel("mgf_blend_backward", tiles, lists.camera, *listed, image, hits, *given, gradients.level, int(stats), sums)
    return sums


def project_backward(
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
        raw: parameters of the Gaussians.
        sh_degree: of the colour.
        lists: as :func:`list_tiles` made them.
        hits: as :func:`blend` made them.
        sums: as :func:`blend_backward` made them.
        level: which rendered maps have gradients.
        statistics: tensors that the statistics are added to.
    """
    gradients = tuple(torch.empty_like(t) for t in raw.all[:5])
    columns = SUMS if statistics is not None or level > _LEVEL_COLOR else 16
    entries = (lists.records, lists.tile_counts, lists.slot_starts, hits, sums, columns)
    given = (len(raw.positions), lists.camera, *raw.all, sh_degree, *entries)
    parallel("mgf_project_backward", *given, *gradients, *(statistics or (None,) * 6))
    return gradients
