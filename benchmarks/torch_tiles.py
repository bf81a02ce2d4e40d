# SPDX-License-Identifier: GPL-3.0-or-later
"""Blending as one would write it in torch: a tile at a time, all Gaussians of its list at all its pixels, autograd.

The yardstick of :mod:`benchmarks.kernels`: float32, the formulas of ``csrc/raster/records.h``, the same lists.
"""

from __future__ import annotations

import torch
from torch import Tensor

from mgf_engine.raster.camera import TILE
from mgf_engine.raster.cpu import TileLists
from mgf_engine.raster.reference import ALPHA_MAX, ALPHA_MIN, T_STOP

#: Columns of a record (csrc/raster/records.h): centre, q, a, b, opacity, colour, normal.
CENTRE, Q, A, B, OPACITY, RGB, NORMAL = (
    slice(0, 2),
    slice(2, 5),
    slice(5, 10),
    slice(10, 13),
    13,
    slice(14, 17),
    slice(17, 20),
)
OUTPUTS = 9  # colour, opacity, depth, normal, distortion


def blend(lists: TileLists, records: Tensor, near: float, far: float) -> Tensor:
    """Return the picture, float32 [9, tiles_y * 16, tiles_x * 16], differentiable in ``records`` [N, 32]."""
    steps = torch.arange(TILE) + 0.5
    v, u = (axis.reshape(-1) for axis in torch.meshgrid(steps, steps, indexing="ij"))
    tiles = []
    for tile in range(lists.tiles_x * lists.tiles_y):
        row, column = divmod(tile, lists.tiles_x)
        listed = lists.gid[lists.ranges[tile] : lists.ranges[tile + 1]].long()
        corner = torch.tensor([TILE * column, TILE * row])
        tiles.append(_blend_tile(records[listed], u + corner[0], v + corner[1], near, far))
    stacked = torch.stack(tiles, 1).view(OUTPUTS, lists.tiles_y, lists.tiles_x, TILE, TILE)
    return stacked.permute(0, 1, 3, 2, 4).reshape(OUTPUTS, lists.tiles_y * TILE, lists.tiles_x * TILE)


def _blend_tile(g: Tensor, u: Tensor, v: Tensor, near: float, far: float) -> Tensor:
    """K Gaussians, front to back, at P pixels: [9, P]."""
    (cx, cy), (q0, q1, q2), (b0, b1, b2) = (g[:, part, None].unbind(1) for part in (CENTRE, Q, B))
    a1, a2, a3, a4, a5 = g[:, A, None].unbind(1)
    dx, dy = u - cx, v - cy
    size = 1 + a1 * dx + a2 * dy + a3 * dx * dx + 2 * a4 * dx * dy + a5 * dy * dy
    response = g[:, OPACITY, None] * torch.exp(-0.5 * (q0 * dx * dx + 2 * q1 * dx * dy + q2 * dy * dy) / size)
    depth = (b0 + b1 * dx + b2 * dy) / size
    taken = (response > ALPHA_MIN) & (depth > near)
    alpha = torch.where(taken, response.clamp_max(ALPHA_MAX), 0.0)
    before = torch.cumprod(torch.cat([torch.ones_like(u)[None], 1 - alpha]), 0)[:-1]
    weight = torch.where(before > T_STOP, alpha * before, 0.0)
    mapped = far / (far - near) * (1 - near / depth.clamp_min(near))
    sums = [torch.cumsum(x, 0) - x for x in (weight, weight * mapped, weight * mapped**2)]
    distortion = weight * (mapped**2 * sums[0] - 2 * mapped * sums[1] + sums[2])
    flat = torch.cat([g[:, RGB].T @ weight, weight.sum(0)[None], (weight * depth).sum(0)[None]])
    return torch.cat([flat, g[:, NORMAL].T @ weight, distortion.sum(0)[None]])
