# SPDX-License-Identifier: GPL-3.0-or-later
"""The 3D low-pass filter: no Gaussian may be finer than the finest photo can show (Mip-Splatting)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.scene import View
from mgf_engine.native.parallel import parallel_map

_VARIANCE = 0.2  # of the filter, in pixels squared of the finest view (Mip-Splatting, section 5.1)
_MARGIN = 0.15  # views count when the centre falls this far outside the frame at most
_NEAR = 1e-3  # nearer than this no photo shows anything
_TABLE = 1 << 19  # points times views worked on at once: what stays in the cache


def update_filter(field: Gaussians, views: Sequence[View], threads: int = 1) -> None:
    """Set ``filter_3d`` from the finest sampling of each centre over ``views``, in place."""
    finest = finest_sampling(field.positions.detach().cpu().numpy(), views, threads)
    seen = finest > 0
    width = np.float32(np.sqrt(_VARIANCE)) / np.where(seen, finest, 1)
    fallback = width[seen].max() if seen.any() else np.float32(1e-3)
    found = torch.from_numpy(np.where(seen, width, fallback))
    field.filter_3d = found.to(field.positions.device)


def finest_sampling(points: NDArray[np.float32], views: Sequence[View], threads: int = 1) -> NDArray[np.float32]:
    """Pixels per unit in the view that samples each of ``points`` [N, 3] most finely; 0 where no view shows it."""
    rotations = np.concatenate([view.rotation for view in views]).astype(np.float32)
    shifts = np.concatenate([view.translation for view in views])[:, None].astype(np.float32)
    fx, fy, cx, cy, width, height = (
        np.array([getattr(view, name) for view in views], np.float32)[:, None]
        for name in ("fx", "fy", "cx", "cy", "width", "height")
    )
    margin = _MARGIN * np.maximum(width, height)
    block = max(1, _TABLE // len(views))

    def sampled(index: int) -> NDArray[np.float32]:
        local = rotations @ points[index * block : (index + 1) * block].T
        local += shifts
        x, y, depth = local.reshape(len(views), 3, -1).transpose(1, 0, 2)
        # In the frame, without dividing: the pixel's distance from the centre of the frame, times depth.
        inside = depth > _NEAR
        inside &= np.abs(x * fx + depth * (cx - width / 2)) < depth * (width / 2 + margin)
        inside &= np.abs(y * fy + depth * (cy - height / 2)) < depth * (height / 2 + margin)
        rate = np.divide(np.maximum(fx, fy), depth, out=np.zeros_like(depth), where=inside)
        return rate.max(0)

    blocks = range(math.ceil(len(points) / block))
    return np.concatenate([np.zeros(0, np.float32), *(rate for rate in parallel_map(sampled, blocks, threads))])
