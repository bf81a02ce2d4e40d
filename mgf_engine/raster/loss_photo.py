# SPDX-License-Identifier: GPL-3.0-or-later
"""Precompute what the training loss needs of a photo: areas of labels, sizes of scales, tiles that count."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mgf_engine.raster.loss_inputs import LossPhoto
from mgf_engine.raster.ms_ssim import scales_of

TILE_H, TILE_W = 32, 256  # px, csrc/raster/loss.h, as the fields and flags
_STRIP = 16  # rows, csrc/raster/normals.h
_LEVEL_FIELDS, _SAVED = 9, 4
_HAS_LABEL, _COVERS_LABEL, _HAS_BAND = 1, 2, 4


def prepare_photo(
    image: Tensor,
    labels: Tensor,
    edges: Tensor,
    background_band: Tensor,
    ids: int,
    elements: int,
    origin: tuple[int, int],
) -> LossPhoto:
    """Prepare a photo for the loss: areas of its labels, sizes of the scales of MS-SSIM, and tiles that count.

    Args:
        image: uint8 [3, h, w].
        labels: uint8 [h, w].
        edges: boundaries of the masks, bool [h, w].
        background_band: bool [h, w].
        ids: number of labels, with 0.
        elements: labels 1..elements are the building.
        origin: row and column of the box in the frame, px.
    """
    mask, (height, width) = labels.numpy(), labels.shape
    scales = scales_of(_areas(mask, ids, elements), height, width)
    levels, flags, area = np.zeros((scales, _LEVEL_FIELDS), np.int64), [], np.zeros((scales, ids), np.int64)
    tiles = floats = 0
    for scale in range(scales):
        h, w = height >> scale, width >> scale
        level_mask = mask[: h << scale : 1 << scale, : w << scale : 1 << scale]
        area[scale] = _areas(level_mask, ids, elements)
        has = _in_tiles(level_mask > 0, 1) * _HAS_LABEL
        covers = _in_tiles(mask > 0, 1 << scale)[: has.shape[0], : has.shape[1]] * _COVERS_LABEL
        extra = _in_tiles(background_band.numpy() > 0, 1) * _HAS_BAND if scale == 0 else 0
        flags.append((has + covers + extra).astype(np.uint8).ravel())
        planes = (3, 3, 3 * _SAVED, 3 if scale else 0)
        starts = floats + np.cumsum((0, *planes)) * h * w
        levels[scale] = h, w, *has.shape, tiles, *starts[:4]
        tiles, floats = tiles + has.size, int(starts[4])
    maps = image, labels, edges, background_band
    image, labels, edges, background_band = (t.view(torch.uint8).contiguous() for t in maps)
    return LossPhoto(
        image=image, labels=labels, elements=elements, edges=edges, background_band=background_band, origin=origin,
        area=area,
        edge_area=int(np.count_nonzero(edges.numpy() * mask)), band_area=int(np.count_nonzero(background_band.numpy())),
        levels=levels, flags=np.concatenate(flags), strips=_blocks(mask > 0, _STRIP, width)[:, 0].astype(np.uint8),
        scratch=floats,
    )  # fmt: skip


def _areas(labels: NDArray[np.uint8], ids: int, elements: int) -> NDArray[np.int64]:
    """Return the pixels of each label, [ids]; in place of label 0, of the whole building."""
    area = np.bincount(labels.ravel(), minlength=ids)
    area[0] = area[1 : elements + 1].sum()
    return np.asarray(area, np.int64)


def _in_tiles(mask: NDArray[np.bool_], factor: int) -> NDArray[np.int64]:
    """Tell which tiles hold a true pixel, 0 or 1, [rows, columns]; ``factor``: size of the mask over the level's."""
    return _blocks(mask, TILE_H * factor, TILE_W * factor).astype(np.int64)


def _blocks(mask: NDArray[np.bool_], height: int, width: int) -> NDArray[np.bool_]:
    """Tell whether each block of the given size holds a true pixel."""
    rows, columns = -(-mask.shape[0] // height), -(-mask.shape[1] // width)
    full = np.zeros((rows * height, columns * width), bool)
    full[: mask.shape[0], : mask.shape[1]] = mask
    return np.asarray(full.reshape(rows, height, columns, width).any((1, 3)))
